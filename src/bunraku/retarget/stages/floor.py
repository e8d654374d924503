"""Nothing sinks into the ground and nothing that stands floats over it: the stage `floor` of fitting.

The root is lifted where the body, without its feet, would sink. Feet are then put on the ground where they stand and
lifted out of it where they do not, by bending their legs. What still sinks lifts the root once more. All lifts are
smooth in time and never less than what is needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import convolve1d, maximum_filter1d

from bunraku.anatomy.ground import lowest
from bunraku.anatomy.joints import Joints
from bunraku.anatomy.legs import Leg, foot_points
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.bending import move_feet
from bunraku.retarget.stages.feet import Contacts, add_bending

__all__ = ["enough", "settle_on_floor"]

HAND = 0.45  # how far from the wrist a hand reaches, over the arm's length; farther out is what it holds
DEPTH = 0.002  # what sinks less than this share of the height is left as it is
SPREAD = 0.15  # how long before and after it is needed a lift begins and ends [s]
LOWERED = 0.08  # how far a standing foot that floats is put down at the most, over the leg's length
HOLD, PULL = 10.0, 0.05  # heights of standing feet, and of others, over the acceleration of their correction


def enough(need: np.ndarray, reach: int) -> np.ndarray:
    """A smooth curve that is nowhere below another one and nowhere larger than that is within twice `reach` frames,
    shape (N,).
    """
    if not need.any():
        return np.zeros(len(need))
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(
        convolve1d(maximum_filter1d(need, 2 * reach + 1, mode="nearest"), window / window.sum(), mode="nearest")
    )


def _lifted(motion: HandleMotion, lift: np.ndarray) -> HandleMotion:
    if not lift.any():
        return motion
    path = motion.root_translation.astype(np.float64)
    path[:, 1] += lift
    return replace(motion, root_translation=path)


def _foot_lifts(heights: np.ndarray, trust: np.ndarray, most: float, depth: float, reach: int) -> np.ndarray:
    """How far a foot is moved up in each frame [m], shape (N,): to the ground where it stands, out of it where it does
    not.

    Args:
        heights: Of its lowest point over the ground [m], shape (N,).
        trust: How much it stands, shape (N,).
        most: How far it is put down at the most [m].
        depth: What may sink [m].
        reach: How many frames before and after it is needed a lift begins and ends.
    """
    goal = np.maximum(-heights, -most)
    band = np.zeros((3, len(heights)))
    band[2] = HOLD * trust + PULL * (1 - trust) + 1e-4
    add_bending(band)
    lifts = solveh_banded(band, HOLD * trust * goal)
    return np.asarray(lifts + enough(np.maximum(-(heights + lifts) - depth, 0), reach))


def _solid(character: Character, handles: Handles, arms: list[Leg], stands: np.ndarray) -> np.ndarray:
    """Vertices that must not sink, shape (V,), bool: what the character stands on, its arms and its hands, but not what
    they hold.
    """
    out = stands.copy()
    for arm in arms:
        out |= character.surface & (handles.weights[:, [arm.upper, arm.lower]].sum(axis=1) > 0.5)
        out[_held(character, arm, True)] = True
    return out


def _held(character: Character, arm: Leg, near: bool) -> np.ndarray:
    """Vertices of a hand that are near its wrist, or those that are not and so what it holds, shape (n,)."""
    away = np.linalg.norm(character.vertices[arm.foot_area] - arm.joints[2], axis=1)
    return np.asarray(arm.foot_area[(away < HAND * arm.length) == near])


def settle_on_floor(
    motion: HandleMotion,
    character: Character,
    handles: Handles,
    joints: Joints,
    legs: list[Leg],
    arms: list[Leg],
    contacts: Contacts | None,
    stands: np.ndarray,
    floor: float,
) -> HandleMotion:
    """The motion with nothing below the ground, and standing feet on it.

    Args:
        motion: Of the character.
        character: In its rest pose.
        handles: Its handles.
        joints: Where they meet.
        legs: Its legs, L.
        arms: Its arms.
        contacts: Of its feet; None where they are not known.
        stands: What may stand on the ground, shape (V,), bool. Arms and hands, but not what they hold, must not sink
            either.
        floor: Height of the ground [m].
    """
    depth, reach = DEPTH * character.height, max(1, round(SPREAD * motion.fps))
    solid = _solid(character, handles, arms, stands)
    limbs = [*legs, *(replace(arm, sole=np.intersect1d(arm.sole, _held(character, arm, True))) for arm in arms)]
    limbs = [limb for limb in limbs if len(limb.sole)]

    def need(some: np.ndarray) -> np.ndarray:
        if not some.any():
            return np.zeros(len(motion))
        return np.maximum(
            floor - depth - lowest(character.vertices[some], handles.weights[some], motion, handles.positions), 0
        )

    ends = np.zeros(len(character.vertices), bool)
    for limb in limbs:
        ends[limb.foot_area] = True
    motion = _lifted(motion, enough(need(solid & ~ends), reach))
    if limbs and len(motion) > 2:
        shifts, transforms = np.zeros((len(motion), len(limbs), 3)), motion.transforms(handles.positions)
        for number, limb in enumerate(limbs):
            heights = foot_points(limb, character, handles, transforms)[..., 1].min(axis=1) - floor
            trust = np.zeros(len(motion))
            if contacts is not None and number < len(legs):
                held = contacts.stands[:, number]
                trust[0], trust[-1], trust[1:-1] = held[0], held[-1], np.maximum(held[1:], held[:-1])
            shifts[:, number, 1] = _foot_lifts(heights, trust, LOWERED * limb.length, depth, reach)
        motion = move_feet(motion, handles, joints, limbs, shifts)
    return _lifted(motion, enough(need(solid), reach))
