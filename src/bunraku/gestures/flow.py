"""Key poses that a body goes through without a stop, as somebody who walks, swims or falls does, and feet that roll.

Hands that go from place to place stop there (`play`); what flows is laid as a pose for each twentieth of a second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bunraku.geometry.easing import MonotoneCurve
from bunraku.gestures.pose import Foot, Hand, Key, Pose

__all__ = ["STEP", "foot_on", "through"]

STEP = 0.05
"""Seconds between two poses."""
_BALL = np.array([0.054, -0.155])
"""From the ball of a foot to its ankle, up and ahead [m]."""
_HEEL = np.array([0.081, 0.05])
"""The same from the heel."""
_GROUND = 0.027
"""Height of the ball [m]."""


def through(keys: Sequence[Key]) -> tuple[Key, ...]:
    """Poses that pass through some others, smooth in position and speed; what is the same in two in a row stays.

    Args:
        keys: Moments [s], in steps of 0.05, and what is reached then; hands are on the same all the time.
    """
    at = _passing([time for time, _ in keys], [pose for _, pose in keys])
    count = round((keys[-1][0] - keys[0][0]) / STEP)
    return tuple((round(keys[0][0] + STEP * index, 3), at(keys[0][0] + STEP * index)) for index in range(count + 1))


def foot_on(out: float, ahead: float, pitch: float = 0.0, turn: float = 8.0) -> Foot:
    """A foot that is on the ground with its ball where the heel is up, and with its heel where the toes are.

    Args:
        out: Of the ankle of a flat foot from the middle [m].
        ahead: The same [m].
        pitch: How far the heel is up over the toes, negative for toes that are up [degrees].
        turn: How far the toes point outwards [degrees].
    """
    cosine, sine = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    up, along = _BALL if pitch > 0 else _HEEL
    height = (_GROUND if pitch > 0 else 0.0) + up * cosine - along * sine
    position = ahead - along + up * sine + along * cosine
    return Foot((out, height, position), pitch, turn=turn)


def _passing(times: Sequence[float], poses: Sequence[Pose]) -> Callable[[float], Pose]:
    curve = MonotoneCurve(times, [_numbers(pose) for pose in poses])
    carriers = poses[0].right.on, poses[0].left.on
    return lambda moment: _pose(iter(curve(moment).tolist()), carriers)


def _numbers(pose: Pose) -> list[float]:
    found: list[float] = []
    for hand in (pose.right, pose.left):
        found += [*hand.palm, *_unit(hand.fingers), *_unit(hand.faces), *_unit(hand.elbow)]
    found += [*pose.lean, *pose.head, pose.shrug, *pose.hips, pose.turn, pose.tilt]
    for foot in (pose.right_foot, pose.left_foot):
        found += [*foot.ankle, foot.pitch, *foot.knee, foot.turn]
    return found


def _unit(vector: Sequence[float]) -> list[float]:
    length = math.hypot(*vector)
    return [value / length for value in vector]


def _pose(numbers: Any, carriers: tuple[Any, Any]) -> Pose:
    def three() -> tuple[float, float, float]:
        return next(numbers), next(numbers), next(numbers)

    right, left = (Hand(three(), three(), three(), three(), on) for on in carriers)
    lean, head, shrug, hips, turn, tilt = three(), three(), next(numbers), three(), next(numbers), next(numbers)
    feet = [Foot(three(), next(numbers), three(), next(numbers)) for _ in range(2)]
    return Pose(right, left, lean, head, shrug, hips, turn, feet[0], feet[1], tilt)
