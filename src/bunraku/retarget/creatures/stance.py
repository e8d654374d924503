"""The pose in which an animal's skeleton stands: four legs down and a level trunk, in the rest pose or in the clip."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import SkeletalMotion, local_rotations
from bunraku.geometry.rotations import matrix_y, nearest_rotation, rotation_between
from bunraku.geometry.steady import tallest_steady
from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles

__all__ = ["Limbs", "Stance", "find_limbs", "find_stance"]

LEVEL = 40.0  # a trunk whose slope is less is level [degrees]
DOWN = 0.55  # a leg stands whose end is so far below its top, over its length along the bones
CLEAR = 0.12  # who stands on the feet has the knees so far above them, over the height of the hips; who crawls has not
NEAR = 0.35  # the ends of front legs are so near to those of the hind legs in height, over the height of the hips
LEAST = 0.15  # share of the frames in which an animal stands on four legs, at the least
MIRROR = np.array([-1.0, 1.0, 1.0])
UPRIGHT = 55.0  # a rest pose whose trunk is steeper is that of a person [degrees]


@dataclass(frozen=True)
class Limbs:
    """The joints of the four legs of a skeleton, left and right.

    Args:
        hind: From the hip outwards, for each side.
        front: From the shoulder outwards, for each side.
    """

    hind: tuple[list[int], list[int]]
    front: tuple[list[int], list[int]]


@dataclass(frozen=True, eq=False)
class Stance:
    """How an animal stands, facing +Z.

    Args:
        turns: World rotation of each joint, shape (J, 3, 3).
        positions: Of the joints [m], shape (J, 3).
        rest: Whether it is the skeleton's rest pose; otherwise the mean of the tallest steady frames in which the
            animal stands, and of its left and right legs.
    """

    turns: np.ndarray
    positions: np.ndarray
    rest: bool


def find_limbs(parts: np.ndarray, parents: np.ndarray) -> Limbs | None:
    """The four legs by what the joints are called; None where one of them has less than two joints.

    Args:
        parts: Handle of each joint, -1 for none, shape (J,).
        parents: Parent of each joint, shape (J,).
    """
    families = []
    for family in FAMILIES:
        sides = []
        for side in SIDES:
            own = np.isin(parts, limb_handles(side, family))
            inner = [joint for joint in np.flatnonzero(own) if parents[joint] < 0 or not own[parents[joint]]]
            lines = [_longest(int(joint), own, parents) for joint in inner]
            sides.append(max(lines, key=len, default=[]))
        families.append((sides[0], sides[1]))
    if min(len(line) for family in families for line in family) < 2:
        return None
    return Limbs(*families)


def _longest(joint: int, own: np.ndarray, parents: np.ndarray) -> list[int]:
    below = [_longest(int(child), own, parents) for child in np.flatnonzero((parents == joint) & own)]
    return [joint, *max(below, key=len, default=[])]


def find_stance(motion: SkeletalMotion, limbs: Limbs, parts: np.ndarray) -> Stance | None:
    """How an animal stands; None of a person, and where four legs are not seen to stand.

    Args:
        motion: Of a skeleton, +Y up [m].
        limbs: Its legs.
        parts: Handle of each joint, -1 for none, shape (J,).
    """
    rest = motion.skeleton.positions.astype(np.float64)[None]
    if bool(_stands(rest, limbs)[0]):
        turn = np.asarray(matrix_y(-_heading(rest, limbs)))[0]
        positions = rest[0] @ turn.T
        return Stance(np.broadcast_to(turn, (len(positions), 3, 3)), positions, True)
    if _person(rest[0], limbs, parts):
        return None
    world, positions = motion.world()
    standing = _stands(positions.astype(np.float64), limbs)
    if standing.mean() < LEAST:
        return None
    # a trunk may be as level in a sitting or a crouching animal
    standing[standing] = tallest_steady(_heights(positions[standing].astype(np.float64), limbs), motion.fps)
    return _mean_stance(motion, world[standing].astype(np.float64), _heading(positions[standing], limbs), limbs)


def _mean_stance(motion: SkeletalMotion, world: np.ndarray, headings: np.ndarray, limbs: Limbs) -> Stance:
    """The mean of some frames, with legs as far ahead on the left as on the right: a clip that ends amid a stride, or
    that begins with a leg ahead, has another mean on either side.
    """
    parents, offsets = motion.skeleton.parents, motion.skeleton.offsets.astype(np.float64)
    local = local_rotations(np.swapaxes(matrix_y(headings), -1, -2)[:, None] @ world, parents)
    turns = nearest_rotation(local.mean(axis=0))
    positions = np.zeros((len(parents), 3))
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        turns[joint] = turns[above] @ turns[joint]
        positions[joint] = positions[above] + turns[above] @ offsets[joint]
    evened = _evening(positions, limbs)
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        if joint not in evened and above in evened:
            evened[joint] = evened[above]
        positions[joint] = positions[above] + evened.get(above, np.eye(3)) @ turns[above] @ offsets[joint]
    turns = np.stack([evened.get(joint, np.eye(3)) @ turn for joint, turn in enumerate(turns)])
    return Stance(turns, positions, False)


def _evening(positions: np.ndarray, limbs: Limbs) -> dict[int, np.ndarray]:
    """The rotations of the bones of the legs of an animal that faces +Z to where they and their mirror images meet."""
    out: dict[int, np.ndarray] = {}
    for left, right in (limbs.hind, limbs.front):
        if len(left) != len(right):
            continue
        for (one, below), (other, under) in zip(pairwise(left), pairwise(right), strict=True):
            bones = positions[below] - positions[one], (positions[under] - positions[other]) * MIRROR
            middle = sum(bone / max(float(np.linalg.norm(bone)), 1e-12) for bone in bones)
            out[one] = rotation_between(bones[0], middle)
            out[other] = rotation_between(bones[1] * MIRROR, middle * MIRROR)
    return out


def _tops(positions: np.ndarray, lines: tuple[list[int], list[int]]) -> np.ndarray:
    return np.asarray(0.5 * (positions[:, lines[0][0]] + positions[:, lines[1][0]]))


def _heading(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """Where the trunk points, about +Y from +Z [rad], shape (N,)."""
    ahead = _tops(positions, limbs.front) - _tops(positions, limbs.hind)
    return np.asarray(np.arctan2(ahead[:, 0], ahead[:, 2]))


def _heights(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """How high the hips and the shoulders are over the lower foot of their pair, in the mean [m], shape (N,)."""
    pairs = [
        _tops(positions, lines)[:, 1] - np.min([positions[:, line[-1], 1] for line in lines], axis=0)
        for lines in (limbs.hind, limbs.front)
    ]
    return np.asarray(np.mean(pairs, axis=0))


def _stands(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """In which poses (N, J, 3) an animal stands on its four feet, shape (N,), bool."""
    trunk = _tops(positions, limbs.front) - _tops(positions, limbs.hind)
    out = np.abs(trunk[:, 1]) < np.sin(np.radians(LEVEL)) * np.linalg.norm(trunk, axis=1)
    feet, knees = [], []
    for lines in (limbs.hind, limbs.front):
        down, length = np.zeros(len(positions)), np.zeros(len(positions))
        for line in lines:
            down += positions[:, line[0], 1] - positions[:, line[-1], 1]
            length += np.linalg.norm(np.diff(positions[:, line], axis=1), axis=-1).sum(axis=1)
        out &= down > DOWN * np.maximum(length, 1e-12)
        feet.append(np.min([positions[:, line[-1], 1] for line in lines], axis=0))
        knees.append(np.min([positions[:, line[1], 1] for line in lines], axis=0))
    hips = _tops(positions, limbs.hind)[:, 1] - feet[0]
    out &= np.abs(feet[0] - feet[1]) < NEAR * hips
    return np.asarray(out & (knees[0] - feet[0] > CLEAR * hips))


def _person(rest: np.ndarray, limbs: Limbs, parts: np.ndarray) -> bool:
    """Whether a rest pose is that of an upright body on two legs."""
    ends = [0.5 * (rest[lines[0][-1]] + rest[lines[1][-1]]) for lines in (limbs.hind, limbs.front)]
    hips, shoulders = (0.5 * (rest[lines[0][0]] + rest[lines[1][0]]) for lines in (limbs.hind, limbs.front))
    trunk, legs = shoulders - hips, ends[0] - hips
    size = max(float(np.linalg.norm(trunk)), 1e-12)
    steep = trunk[1] > np.sin(np.radians(UPRIGHT)) * size
    tail = np.isin(parts, [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]).any()
    return bool(steep and legs[1] < -0.5 * np.linalg.norm(legs) and not tail)
