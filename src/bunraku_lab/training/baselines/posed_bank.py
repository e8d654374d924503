"""What pose transfer trains on: characters with people's rigs, of network size, in the same poses, computed once.

The root neither turns nor travels: what a pose transfer has to say is how the parts move in the frame of the pelvis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from bunraku.apparel.unified import UnifiedBody
from bunraku.body.reference import reference_body, reference_shapes
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write, sweep
from bunraku.geometry.simplify import network_mesh
from bunraku.retarget.fit import Stages
from bunraku.retarget.to_rig import fit_rig
from bunraku_lab.baselines.pose_transfer import ROOM, PartMesh, predicted_parts
from bunraku_lab.datasets.characters.build import HELD_OUT, RIGGED, no_characters, rigged_files
from bunraku_lab.datasets.characters.known_rigs import facing_turn
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.training.baselines.transfer_pairs import REFERENCE, Target

__all__ = ["BankPlan", "build_posed_bank", "pose_frames", "posed_sample", "rootless"]

POSING = Stages(**{each.name: each.name in ("rest_pose", "attach") for each in fields(Stages)})
"""Limbs as the pose has them, joined to one another; no stage that looks at time or at the ground."""


@dataclass(frozen=True)
class BankPlan:
    """What a bank is made of.

    Args:
        motions: Folder that `bunraku data motions` wrote.
        characters: Folder of rigged characters.
        wardrobe: Characters of the wardrobe beside them.
        poses: P.
        vertices: Of a mesh, about.
        seed: Of the poses.
    """

    motions: Path
    characters: Path
    wardrobe: int = 40
    poses: int = 96
    vertices: int = 1000
    seed: int = 0


def rootless(motion: HandleMotion) -> HandleMotion:
    """A motion whose root stays as it is at rest."""
    still = np.tile(np.eye(3), (len(motion), 1, 1))
    return replace(motion, root_rotation=still, root_translation=np.zeros((len(motion), 3)))


def pose_frames(motions: Path, count: int, seed: int = 0) -> HandleMotion:
    """Single frames of people's training clips, of as many clips.

    Raises:
        FormatError: There are no such clips.
    """
    known = load_index(motions)
    names = sorted(name for name, row in known.items() if row["split"] == "train" and "species" not in row)
    if not names:
        raise FormatError(motions, "there are no people's clips here; build them with `bunraku data motions`")
    random = np.random.default_rng(seed)
    frames = []
    for _ in range(count):
        clip = load_clip(motions / f"{names[int(random.integers(len(names)))]}.npz")
        frames.append(clip.take(slice(row := int(random.integers(len(clip))), row + 1)))
    joined = {name: np.concatenate([getattr(one, name) for one in frames]) for name in HandleMotion.arrays}
    return frames[0].with_arrays(joined)


def posed_sample(character: Character, name: str, poses: HandleMotion, vertices: int) -> Target:
    """A rigged character in poses, x and z from its root handle.

    Args:
        character: Facing +Z, with a person's rig.
        name: Its name.
        poses: Motion of the reference body.
        vertices: Of its mesh, about.

    Raises:
        CharacterError: There is no rig, or it is not a person's.
    """
    body = UnifiedBody.of(character)
    moved = fit_rig(rootless(poses), body.parts, POSING).vertices()
    mesh = network_mesh(character.vertices, character.faces, round(ROOM * vertices))
    rest, skinning = mesh.pull(character.vertices), mesh.pull(body.weights)
    weights = predicted_parts(rest, mesh.normals, mesh.edges, mesh.areas)
    height = np.float32(character.height)
    root = weights[:, 0] @ rest / max(float(weights[:, 0].sum()), 1e-9)
    origin = np.array([root[0], rest[:, 1].min(), root[2]], np.float32)
    truth = mesh.pull(moved.transpose(1, 0, 2).reshape(len(character.vertices), -1))
    truth = truth.reshape(len(rest), -1, 3).transpose(1, 0, 2)
    return Target(
        name, PartMesh((rest - origin) / height, mesh.faces, mesh.edges, weights),
        skinning / skinning.sum(axis=1, keepdims=True), np.ascontiguousarray((truth - origin) / height, np.float32),
    )  # fmt: skip


def build_posed_bank(
    plan: BankPlan, folder: Path, progress: Callable[[float], None] | None = None
) -> dict[str, list[Target]]:
    """Characters to learn from and those held out ("train", "val"), computed where they are not there yet; those that
    have no person's rig are left out.

    Args:
        plan: What it is made of.
        folder: Where it is kept.
        progress: Called with the share done.

    Raises:
        FormatError: There are no rigged characters, or no people's clips.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    poses = pose_frames(plan.motions, plan.poses, plan.seed)
    makers = _makers(plan)
    out: dict[str, list[Target]] = {"train": [], "val": []}
    for number, (name, make) in enumerate(makers.items()):
        path = folder / f"{name.replace('/', '__')}.npz"
        if not path.is_file():
            try:
                sample = posed_sample(make(), name, poses, plan.vertices)
            except BunrakuError:
                continue
            with atomic_write(path) as file:
                np.savez(file, **vars(sample.mesh), skinning=sample.skinning, truth=sample.truth)
        out["val" if name in HELD_OUT else "train"].append(_read(path, name))
        if progress is not None:
            progress((number + 1) / len(makers))
    return out


def _makers(plan: BankPlan) -> dict[str, Callable[[], Character]]:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    out: dict[str, Callable[[], Character]] = {}
    for shape in reference_shapes():
        out[f"{REFERENCE}{shape}"] = lambda shape=shape: reference_body(shape).character()  # type: ignore[misc]
    files = rigged_files(plan.characters)
    if not files:
        raise no_characters(plan.characters, RIGGED)
    for file in files:
        name = file.relative_to(plan.characters).with_suffix("").as_posix()
        out[name] = lambda file=file, name=name: _facing(file, name)  # type: ignore[misc]
    for seed in range(plan.wardrobe):
        out[f"wardrobe_{seed:06d}"] = lambda seed=seed: wardrobe_character(seed)  # type: ignore[misc]
    return out


def _facing(file: Path, name: str) -> Character:
    """A rigged file facing +Z."""
    from bunraku.io import load_character

    character = load_character(file)
    if character.rig is None:
        return character
    turn = facing_turn(name, character.rig.names, character.rig.positions)
    transforms = character.rig.transforms.copy()
    transforms[:, :3] = turn @ transforms[:, :3]
    vertices = character.vertices @ turn.T.astype(np.float32)
    return replace(character, vertices=vertices, rig=replace(character.rig, transforms=transforms), source=None)


def _read(path: Path, name: str) -> Target:
    try:
        with np.load(path, allow_pickle=False) as file:
            own = {key: file[key] for key in file.files}
            mesh = PartMesh(**{key: own[key] for key in ("rest", "faces", "edges", "weights")})
            return Target(name, mesh, own["skinning"], own["truth"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"this is no posed character ({error}); remove it and train again") from None
