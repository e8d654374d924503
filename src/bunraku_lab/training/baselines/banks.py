"""What the baselines train on: small meshes of characters in poses, and the pairs that pose transfer learns from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.apparel.body import UnifiedBody, eq4_transforms
from bunraku.core.body.reference import reference_body, reference_shapes
from bunraku.core.character import Character
from bunraku.core.geometry.simplify import NetworkMesh, network_mesh
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.retarget.fit import Stages
from bunraku.retarget.to_rig import fit_rig
from bunraku_lab.baselines.pose_transfer import (
    ROOM,
    PartMesh,
    in_root_frame,
    predicted_parts,
    source_body,
    source_rotations,
)
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.shards import ApparelClip
from bunraku_lab.datasets.characters.build import HELD_OUT, RIGGED, no_characters, rigged_files
from bunraku_lab.datasets.characters.training_character import facing_ahead
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.training.rows.banks import kept_arrays

REFERENCE = "reference_"
"""What the names of the reference body's shapes begin with."""
OF_REFERENCE = 0.5
"""Share of the pairs whose source is one of them; the others' is any character. The tables' baselines were trained with
it.
"""


@dataclass(frozen=True, eq=False)
class Target:
    """A character in P poses; lengths over its height, in the frame of the root.

    Args:
        name: Its name.
        mesh: At rest.
        skinning: True weights of the joints, shape (M, 22).
        truth: Its vertices in the poses, shape (P, M, 3).
        turns: Rotations of the reference body's joints in the poses, shape (P, 22, 3, 3); None where all share poses.
        source: The reference body at rest as the character rests; None where the poses are those of all characters.
    """

    name: str
    mesh: PartMesh
    skinning: np.ndarray
    truth: np.ndarray
    turns: np.ndarray | None = None
    source: PartMesh | None = None


@dataclass(frozen=True, eq=False)
class Pair:
    """A source in a pose, and a target.

    Args:
        source: At rest.
        source_skinning: True weights of the source's joints, shape (M_s, 22).
        posed: The source's vertices in the pose, shape (M_s, 3).
        target: The target.
        pose: Which of the target's poses it is.
    """

    source: PartMesh
    source_skinning: np.ndarray
    posed: np.ndarray
    target: Target
    pose: int

    @property
    def truth(self) -> np.ndarray:
        """The target's vertices in the pose, shape (M, 3)."""
        return np.asarray(self.target.truth[self.pose])


def drawn_pairs(characters: Sequence[Target], count: int, random: np.random.Generator) -> list[Pair]:
    """Pairs of one source: in one pose where all share poses, else the reference body in each target's pose."""
    targets = [characters[number] for number in random.integers(len(characters), size=count)]
    if targets[0].turns is not None:
        out = []
        for target in targets:
            assert target.turns is not None and target.source is not None
            pose = int(random.integers(len(target.truth)))
            body = source_body()
            out.append(Pair(target.source, body.skinning, body.posed(target.turns[pose : pose + 1])[0], target, pose))
        return out
    shapes = [one for one in characters if one.name.startswith(REFERENCE)]
    pool = shapes if shapes and random.random() < OF_REFERENCE else list(characters)
    source = pool[int(random.integers(len(pool)))]
    pose = int(random.integers(len(source.truth)))
    return [Pair(source.mesh, source.skinning, source.truth[pose], target, pose) for target in targets]


@dataclass(frozen=True, eq=False)
class ClothedSample:
    """A character of M vertices in P frames.

    Args:
        name: Of the character.
        rest: In the rest pose [m], shape (M, 3).
        normals: Shape (M, 3).
        faces: Shape (F, 3).
        edges: Of the faces, and those that join loose parts, shape (E, 2).
        areas: Share of the surface of each vertex, shape (M,).
        joints: J [m], shape (22, 3).
        weights: True skinning weights, shape (M, 22).
        apparel: Share of each vertex that is apparel, shape (M,).
        affine: Affine transforms of the joints, shape (P, 22, 3, 4).
        truth: Where the vertices are [m], shape (P, M, 3).
    """

    name: str
    rest: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    areas: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    apparel: np.ndarray
    affine: np.ndarray
    truth: np.ndarray


def clothed_sample(
    data: ApparelData, clips: list[ApparelClip], mesh: NetworkMesh, frames: int, seed: int
) -> ClothedSample:
    """A character in some frames of its clips, evenly taken."""
    character = data.character(clips[0])
    random = np.random.default_rng(seed)
    affine, truth = [], []
    for clip in clips:
        share = max(1, round(frames * clip.frames / sum(one.frames for one in clips)))
        rows = ((np.arange(share) + random.random()) * clip.frames / share).astype(np.int64)
        window = data.window(clip)
        affine.append(eq4_transforms(window.transforms[rows], character.joints))
        moved = mesh.pull(window.vertices[rows].transpose(1, 0, 2).reshape(len(character.rest), -1))
        truth.append(moved.reshape(len(moved), -1, 3).transpose(1, 0, 2))
    weights = mesh.pull(character.weights)
    return ClothedSample(
        character.name, mesh.pull(character.rest), mesh.normals, mesh.faces, mesh.edges, mesh.areas,
        character.joints.astype(np.float32), weights / weights.sum(axis=1, keepdims=True),
        mesh.pull(character.apparel[:, None].astype(np.float64))[:, 0],
        np.concatenate(affine), np.ascontiguousarray(np.concatenate(truth), np.float32),
    )  # fmt: skip


def build_clothed_bank(
    data: ApparelData, folder: Path, vertices: int = 1000, frames: int = 48,
    progress: Callable[[float], None] | None = None, most: int | None = None,
) -> list[ClothedSample]:  # fmt: skip
    """The characters of a split, computed where they are not there yet; those that cannot be used are left out. Meshes
    have from three quarters to five quarters of the vertices, on grids that lie anyhow.

    Args:
        data: The data set, of one split.
        folder: Where they are kept.
        vertices: Of a mesh, about.
        frames: Of each character.
        most: How many characters at the most.
    """
    makers = {name: lambda name=name: _sampled(data, name, vertices, frames) for name in data.characters[:most]}
    return [ClothedSample(name, **arrays) for name, arrays in kept_arrays(folder, makers, progress)]


def _sampled(data: ApparelData, name: str, vertices: int, frames: int) -> dict[str, np.ndarray]:
    clips = [clip for clip in data.clips if clip.character == name]
    character = data.character(clips[0])
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
    random = np.random.default_rng(seed)
    room = round(ROOM * vertices * random.uniform(0.75, 1.25))
    x, y, z = random.random(3)
    mesh = network_mesh(character.rest, character.faces, room, offset=(x, y, z))
    sample = clothed_sample(data, clips, mesh, frames, seed)
    return {key: value for key, value in vars(sample).items() if key != "name"}


def clothed_target(sample: ClothedSample) -> Target:
    """A character of the data set, and the source's turns in each of its frames."""
    low, height = sample.rest[:, 1].min(), np.float32(np.ptp(sample.rest[:, 1]))
    origin = np.array([sample.joints[0, 0], low, sample.joints[0, 2]], np.float32)
    _, truth = in_root_frame(sample.affine, sample.truth)
    weights = predicted_parts(sample.rest, sample.normals, sample.edges, sample.areas)
    mesh = PartMesh((sample.rest - origin) / height, sample.faces, sample.edges, weights)
    turns = source_rotations(sample.affine[..., :3], sample.joints)
    source = source_body().resting_as(sample.joints)
    return Target(sample.name, mesh, sample.weights, (truth - origin) / height, turns, source)


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

    Raises:
        FormatError: There are no rigged characters, or no people's clips.
    """
    poses = pose_frames(plan.motions, plan.poses, plan.seed)

    def arrays(name: str, make: Callable[[], Character]) -> dict[str, np.ndarray]:
        sample = posed_sample(make(), name, poses, plan.vertices)
        return vars(sample.mesh) | {"skinning": sample.skinning, "truth": sample.truth}

    out: dict[str, list[Target]] = {"train": [], "val": []}
    makers = {name: partial(arrays, name, make) for name, make in _makers(plan).items()}
    for name, own in kept_arrays(folder, makers, progress):
        skinning, truth = own.pop("skinning"), own.pop("truth")
        out["val" if name in HELD_OUT else "train"].append(Target(name, PartMesh(**own), skinning, truth))
    return out


def _makers(plan: BankPlan) -> dict[str, Callable[[], Character]]:
    from bunraku.files import load_character
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    out: dict[str, Callable[[], Character]] = {}
    for shape in reference_shapes():
        out[f"{REFERENCE}{shape}"] = lambda shape=shape: reference_body(shape).character()  # type: ignore[misc]
    files = rigged_files(plan.characters)
    if not files:
        raise no_characters(plan.characters, RIGGED)
    for file in files:
        name = file.relative_to(plan.characters).with_suffix("").as_posix()
        out[name] = lambda file=file, name=name: facing_ahead(load_character(file), name)  # type: ignore[misc]
    for seed in range(plan.wardrobe):
        out[f"wardrobe_{seed:06d}"] = lambda seed=seed: wardrobe_character(seed)  # type: ignore[misc]
    return out
