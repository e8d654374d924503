"""A standing person who makes a gesture: sways and breathes, made by code or captured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.core.body.layout import JOINT_COUNT, JOINT_MIRROR, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.motion import SkeletalMotion

AT = {name: index for index, name in enumerate(JOINT_NAMES)}
"""Numbers of the joints by their names."""
SIDES = (("left", 1.0), ("right", -1.0))
"""Both sides, with the sign of x on them."""
PALM = 0.09
"""From the wrist to the middle of the palm, chosen by eye on sheets of gestures [m]."""
ANKLE, APART, BESIDE, TURNED = 0.035, 0.55, 0.12, 30.0
"""How far an ankle of a standing foot is from its height at rest at the most, how far apart feet are at the most, and
from side to side at the least [m], and how far the head is turned from the pelvis at the most [degrees]; chosen by eye.
"""
_STILL = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))


@dataclass(frozen=True)
class Hanging:
    """A hand that does nothing, in N frames."""

    palm: np.ndarray  # in the frame of the chest, from its joint [m], shape (N, 3)
    ways: np.ndarray  # where fingers point, palm faces and elbow is bent, in that frame, shape (N, 3, 3)


@dataclass(frozen=True)
class Planted:
    """A foot that stands, in N frames."""

    ankle: np.ndarray  # position [m], shape (N, 3)
    knee: np.ndarray  # direction to which the knee is bent, shape (N, 3)
    rotation: np.ndarray  # of the foot in the world, shape (N, 3, 3)
    toes: np.ndarray  # of the toes in the world, shape (N, 3, 3)


@dataclass(frozen=True)
class Standing:
    """A standing person in N frames, facing +z."""

    hips: np.ndarray  # where the pelvis is from where it is at rest [m], shape (N, 3)
    # of the joints relative to their parents; those of arms and legs are not read, shape (N, 22, 3, 3)
    rotations: np.ndarray
    lean: np.ndarray  # added to that of the keys, shape (N, 3) [degrees]
    head: np.ndarray  # the same of the head
    hands: dict[str, Hanging | None]  # by side; None where they hang as the keys say
    feet: dict[str, Planted | None]  # by side; None where they stand as the keys say
    sways: bool = False  # the pelvis sways even where the feet step


def still(frames: int) -> Standing:
    """A person who does not move at all, for this many frames."""
    none = np.zeros((frames, 3))
    return Standing(none, np.tile(_STILL, (frames, 1, 1, 1)), none, none, *_as_keys())


def _as_keys() -> tuple[dict[str, Hanging | None], dict[str, Planted | None]]:
    """Hands and feet that are as the keys say."""
    return {side: None for side, _ in SIDES}, {side: None for side, _ in SIDES}


def swaying(seed: int, moments: np.ndarray) -> Standing:
    """Small slow movements of a standing person, made by code.

    Args:
        seed: Of their phases.
        moments: Of the frames, shape (N,) [s].
    """
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 6)
    slow = np.array([0.17, 0.13, 0.27, 0.11, 0.19, 0.15])  # breaths are the third, sixteen a minute
    # of the pelvis to the left and ahead [m], the lean of the chest and the three angles of the head [degrees]
    large = np.array([0.010, 0.006, 0.9, 1.5, 2.0, 1.0])
    sway = large * np.sin(2 * np.pi * slow * moments[:, None] + phases)
    none = np.zeros(len(moments))
    hips, lean = np.stack([sway[:, 0], none, sway[:, 1]], axis=1), np.stack([sway[:, 2], none, none], axis=1)
    return Standing(hips, np.tile(_STILL, (len(moments), 1, 1, 1)), lean, sway[:, 3:], *_as_keys(), sways=True)


def stands_well(motion: SkeletalMotion) -> bool:
    """Whether both feet stand flat side by side in all frames and the head looks ahead, as a gesture needs it."""
    rest = reference_body().joints
    rotations, positions = motion.world()
    across = positions[:, AT["left_hip"]] - positions[:, AT["right_hip"]]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    looks = (rotations[:, AT["head"], :, 2] * across).sum(axis=1)
    ankles = positions[:, [AT["left_ankle"], AT["right_ankle"]]]
    level = np.abs(ankles[..., 1] - rest[AT["left_ankle"], 1]).max() < ANKLE
    beside = ((ankles[:, 0] - ankles[:, 1]) * across).sum(axis=1).min() > BESIDE
    ahead = np.abs(looks).max() < np.sin(np.radians(TURNED))
    return bool(level and beside and ahead and np.linalg.norm(ankles[:, 0] - ankles[:, 1], axis=1).max() < APART)


def mirrored(motion: SkeletalMotion) -> SkeletalMotion:
    """The mirror image of a motion of the reference body's 22 joints."""
    flip = np.array([-1.0, 1, 1])
    rotations = motion.rotations[:, list(JOINT_MIRROR)] * np.outer(flip, flip)
    return SkeletalMotion(motion.skeleton, rotations, motion.root_translation * flip, motion.fps)


def captured(motion: SkeletalMotion, at: np.ndarray) -> Standing:
    """A person who was captured standing.

    Args:
        motion: Of the reference body's 22 joints, at rest where its feet are.
        at: Frames of it, which need not be whole, shape (N,).
    """
    low = np.clip(at.astype(int), 0, max(len(motion) - 2, 0))
    share = np.clip(at - low, 0, 1)
    high = np.minimum(low + 1, len(motion) - 1)
    rest = reference_body().joints.astype(float)
    rotations, positions = (value.astype(float) for value in motion.world())
    facing = matrix_y(np.array(-np.mean(heading(rotations[:, 0], motion.fps))))
    ankles = positions[:, [AT["left_ankle"], AT["right_ankle"]]].mean(axis=(0, 1))
    positions = (positions - ankles * [1, 0, 1]) @ facing.T
    rotations = facing @ rotations
    mixed = (1 - share)[:, None, None, None] * rotations[low] + share[:, None, None, None] * rotations[high]
    world = _orthonormal(mixed)
    where = (1 - share)[:, None, None] * positions[low] + share[:, None, None] * positions[high]
    parents = motion.skeleton.parents
    local = world.copy()
    local[:, 1:] = np.swapaxes(world[:, parents[1:]], -1, -2) @ world[:, 1:]
    hands: dict[str, Hanging | None] = {}
    feet: dict[str, Planted | None] = {}
    chest = AT["spine3"]
    for side, sign in SIDES:
        wrist, elbow, shoulder = (AT[f"{side}_{part}"] for part in ("wrist", "elbow", "shoulder"))
        pointing = world[:, wrist] @ [sign, 0, 0]
        bent = _aside(where[:, shoulder], where[:, elbow], where[:, wrist], world[:, shoulder] @ [0, 0, -1.0])
        ways = np.stack([pointing, world[:, wrist] @ [0, -1.0, 0], bent], axis=1)
        palm = where[:, wrist] + PALM * pointing - where[:, chest]
        hands[side] = Hanging((palm[:, None] @ world[:, chest])[:, 0], ways @ world[:, chest])
        ankle, toes = AT[f"{side}_ankle"], AT[f"{side}_foot"]
        # knees bend over the toes when the person sits down, wherever those of a straight leg happen to point
        bend = world[:, ankle] @ [0.15 * sign, 0, 1.0] * [1, 0, 1]
        feet[side] = Planted(where[:, ankle], bend, world[:, ankle], world[:, toes])
    still = np.zeros((len(at), 3))
    return Standing(where[:, 0] - rest[0], local, still, still, hands, feet)


def _orthonormal(matrices: np.ndarray) -> np.ndarray:
    """Rotations nearest to means of two that are near each other."""
    first = matrices[..., 0] / np.linalg.norm(matrices[..., 0], axis=-1, keepdims=True)
    second = matrices[..., 1] - (matrices[..., 1] * first).sum(-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _aside(start: np.ndarray, bend: np.ndarray, end: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """To where a limb is bent; where it is straight, to where it would be, unit vectors (N, 3)."""
    along = end - start
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    off = bend - start
    off = off - (off * along).sum(1, keepdims=True) * along
    off = off + 0.02 * (straight - (straight * along).sum(1, keepdims=True) * along)
    return np.asarray(off / np.maximum(np.linalg.norm(off, axis=1, keepdims=True), 1e-9))
