"""One character of the table of motion transfer: what is measured of it with every motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Required, TypedDict

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.body.reference import LIMB_CHILD
from bunraku.core.character import Character
from bunraku.core.geometry.axes import AXES, axis_vector, upright_rotation
from bunraku.core.motion import HandleMotion, posed_points
from bunraku.errors import BunrakuError, FormatError
from bunraku.retarget.fit import Stages
from bunraku.retarget.rig_parts import RigParts

SECONDS = 8.0  # of each motion
STRIDE = 4  # frames from one that is measured to the next
CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)
"""What carries a motion over, without what corrects it."""


@dataclass(frozen=True)
class Source:
    """A motion that characters are measured with.

    Args:
        motion: Of the reference body; see `of`.
        joints: Where SMPL's 22 joints are in it [m], shape (N, 22, 3).
    """

    motion: HandleMotion
    joints: np.ndarray

    @classmethod
    def of(cls, motion: HandleMotion) -> Source:
        """The first seconds of a motion of the reference body."""
        from bunraku.core.body.reference import reference_body

        motion = motion.take(slice(0, round(SECONDS * motion.fps)))
        body = reference_body()
        world = motion.transforms(body.handles.positions).astype(np.float64)[:, :JOINT_COUNT]
        return cls(motion, posed_points(world, body.joints))


def facing_character(path: Path, name: str) -> Character:
    """A character facing +Z, by what is known of the archive's rigs."""
    from bunraku.files import load_character, rotated

    character = load_character(path)
    return rotated(character, "+y", named_front(character, name))


def named_front(character: Character, name: str) -> str:
    """The axis that a character faces, by what is known of the archive's rigs."""
    from bunraku_lab.datasets.characters.training_character import facing_rotation

    if character.rig is None:
        return "+z"
    ahead = facing_rotation(name, character.rig.names, character.rig.positions).T @ np.array([0.0, 0, 1])
    return max(AXES, key=lambda axis: float(axis_vector(axis) @ ahead))


class _Back(TypedDict, total=False):
    back: float
    back_copied: float


class CharacterRow(TypedDict, total=False):
    """What was measured on a character (`measure_character`)."""

    name: Required[str]
    finished: Required[int]
    failed: Required[dict[str, str]]
    vertices: int
    humanoid: bool
    angle_rig: float
    angle_handles: float
    back: float
    back_copied: float


def measure_character(path: Path, name: str, sources: Mapping[str, Source]) -> CharacterRow:
    """What is measured of a character, in values that JSON can hold.

    Args:
        path: Its file.
        name: Its path in the archive, without suffix, by which known rigs are recognised.
        sources: Motions by their kinds.

    Returns:
        `name`; `finished`, how many motions came through; `failed`, reasons by kind, "" for the character itself; and
        where it could be read `vertices` and `humanoid`, whether it has a rig of one. Of those: `angle_rig` and
        `angle_handles` [degrees], and with clips `back` and `back_copied`, over the height.
    """
    row: CharacterRow = {"name": name, "finished": 0, "failed": {}}
    try:
        _measure(path, facing_character(path, name), sources, row)
    except BunrakuError as error:
        row["failed"][""] = str(error)
    return row


def _measure(path: Path, character: Character, sources: Mapping[str, Source], row: CharacterRow) -> None:
    from bunraku.pipelines.animate import rig
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.requests import TransferRequest
    from bunraku.pipelines.transfer import fitted_transfer

    try:
        parts = RigParts.of(character)
    except BunrakuError:
        parts = None
    humanoid = parts is not None and parts.humanoid
    row["vertices"], row["humanoid"] = len(character.vertices), humanoid
    handles = rig(character)
    on_rig: list[float] = []
    on_handles: list[float] = []
    for kind, source in sources.items():
        try:
            frames = np.arange(0, len(source.motion), STRIDE)
            result = fitted_transfer(
                Animator.shipped(), character, source.motion, TransferRequest("handles", handles=handles)
            )
            posed = result.vertices(frames)
            if not np.isfinite(posed).all():
                raise FormatError(path, "the result holds values that are not numbers")
            row["finished"] += 1
            if humanoid:
                assert parts is not None
                on_handles.append(
                    float(limb_angles(parts, carried_heads(parts, result, frames), source.joints[frames]).mean())
                )
                moved = fitted_transfer(Animator.shipped(), character, source.motion, TransferRequest("rig"))
                assert isinstance(moved, RigAnimation)
                on_rig.append(float(limb_angles(parts, _rig_heads(parts, moved, frames), source.joints[frames]).mean()))
        except BunrakuError as error:
            row["failed"][kind] = str(error)
    if humanoid and on_rig:
        row["angle_rig"], row["angle_handles"] = float(np.mean(on_rig)), float(np.mean(on_handles))
        row.update(_there_and_back(path, character, row["name"]))


def _there_and_back(path: Path, character: Character, name: str) -> _Back:
    """Mean error of a character's own clip after the way to the reference body and back, over its height."""
    from bunraku.files import clip_names, load_animation
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.requests import TransferRequest
    from bunraku.pipelines.to_reference import reference_motion
    from bunraku.pipelines.transfer import fitted_transfer, same_skeleton

    try:
        clip = load_animation(path, 0, 20.0)
        names = clip_names(clip.character.source.document)
        clip = load_animation(
            path, next((number for number, title in enumerate(names) if "walk" in title.lower()), 0), 20.0
        )
        truth, height = clip.vertices(), clip.character.height
        back = fitted_transfer(
            Animator.shipped(), character, reference_motion(clip), TransferRequest("rig", stages=CARRIED)
        )
        copied = same_skeleton(clip.character, clip)
    except BunrakuError:
        return {}
    turn = upright_rotation("+y", named_front(clip.character, name))
    out: _Back = {"back": float(np.linalg.norm(back.vertices() - truth @ turn.T, axis=-1).mean() / height)}
    if copied is not None:
        out["back_copied"] = float(np.linalg.norm(copied.vertices() - truth, axis=-1).mean() / height)
    return out


def limb_angles(parts: RigParts, heads: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Angles between limbs of a result and of its source [degrees], shape (N, limbs): arms and legs.

    Args:
        parts: The rig that names the limbs.
        heads: Where the joints of its handles are in the result [m], shape (N, 30, 3).
        source: Where SMPL's 22 joints are in the source [m], shape (N, 22, 3).
    """
    out = []
    for joint, child in LIMB_CHILD.items():
        if min(parts.leads[joint], parts.leads[child]) >= 0:
            own, want = heads[:, child] - heads[:, joint], source[:, child] - source[:, joint]
            scale = np.linalg.norm(own, axis=1) * np.linalg.norm(want, axis=1)
            out.append(np.degrees(np.arccos(np.clip((own * want).sum(axis=1) / np.maximum(scale, 1e-12), -1, 1))))
    return np.stack(out, axis=1)


def _rig_heads(parts: RigParts, animation: RigAnimation, frames: np.ndarray) -> np.ndarray:
    return np.asarray(animation.world()[1][frames][:, np.maximum(parts.leads, 0)])


def carried_heads(parts: RigParts, animation: Animation | RigAnimation, frames: np.ndarray) -> np.ndarray:
    """Where skinning takes a rig's joints: the mean of the vertices that both parts of the joint hold."""
    own = parts.handles.weights.astype(np.float64)
    world = animation.motion.transforms(animation.handles.positions)[frames].astype(np.float64)
    heads = np.tile(parts.joints.positions, (len(world), 1, 1))
    for handle in range(1, JOINT_COUNT):
        head = parts.joints.positions[handle]
        mass = own[:, handle] * own[:, max(int(parts.joints.parents[handle]), 0)]
        if mass.sum() < 0.05:  # parts that do not overlap: what is nearest to the joint
            mass = np.zeros(len(own))
            mass[np.argsort(((parts.character.vertices - head) ** 2).sum(axis=1))[:12]] = 1.0
        blend = np.einsum("k,nkij->nij", (mass / mass.sum()) @ animation.handles.weights, world)
        heads[:, handle] = blend[..., :3] @ head + blend[..., 3]
    return heads


SUFFIXES = (".glb", ".gltf", ".vrm", ".fbx")
