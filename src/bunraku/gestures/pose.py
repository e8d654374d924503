"""What a gesture is: a few key poses of the reference body, the flow through those that it does not stop at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from bunraku.core.geometry.curves import MonotoneCurve

Vector = tuple[float, float, float]


def added(one: Vector, other: Vector) -> Vector:
    """The sum of two vectors."""
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def vector(values: np.ndarray) -> Vector:
    """Three numbers as a key pose keeps them."""
    x, y, z = np.asarray(values, float).tolist()
    return x, y, z


@dataclass(frozen=True)
class Hand:
    """Where a hand is and how it is held: by default as at work on a table."""

    palm: Vector  # position of the middle of the palm
    fingers: Vector = (-0.3, 0.1, 1.0)  # direction in which the fingers point
    faces: Vector = (0.0, -1.0, 0.0)  # direction in which the palm faces
    elbow: Vector = (0.6, -1.0, -0.3)  # direction from the line between shoulder and wrist to the elbow
    # what carries the position: "head", "chest", "hips", or "ground" for one that stays in the world
    on: Literal["head", "chest", "hips", "ground"] = "chest"


HANGING = Hand((0.27, 0.845, 0.06), (0.0, -1.0, 0.12), (-1.0, 0.0, 0.1), (0.35, 0.0, -1.0))
"""A hand of an arm that hangs. Chosen by eye on sheets of gestures."""


@dataclass(frozen=True)
class Foot:
    """Where a foot is."""

    ankle: Vector = (0.12, 0.081, 0.0)  # position of the ankle
    pitch: float = 0.0  # how far the heel is up over the toes [degrees]
    knee: Vector = (0.15, 0.0, 1.0)  # direction to which the knee is bent
    turn: float = 8.0  # how far the toes point outwards [degrees]


@dataclass(frozen=True)
class Pose:
    """The body at one moment."""

    right: Hand = HANGING
    left: Hand = HANGING
    # of the upper body: ahead, to the left about the vertical, to the right side [degrees]
    lean: Vector = (0.0, 0.0, 0.0)
    head: Vector = (0.0, 0.0, 0.0)  # the same of the head, seen from the chest
    shrug: float = 0.0  # how far both shoulders are up, 0 to 1
    # where the pelvis goes from where it is in a standing body [m]: x to the body's left
    hips: Vector = (0.0, 0.0, 0.0)
    turn: float = 0.0  # of the pelvis to the left [degrees]
    right_foot: Foot = field(default_factory=Foot)
    left_foot: Foot = field(default_factory=Foot)
    tilt: float = 0.0  # of the pelvis ahead: 90 on the belly, -90 on the back [degrees]


Key = tuple[float, Pose]
"""A moment [s] and the pose that is reached then."""


SAME = 0.12
"""Distance of hands, feet or hips up to which two poses are the same [m]. Of 37 gestures that are done once and end in
another pose than they begin, 16 differ by .09 at the most and 21 by .15 or more.
"""


@dataclass(frozen=True)
class Repeat:
    """Which of a gesture's keys are one time of what is done again and again."""

    start: float  # when the first time begins [s]
    period: float  # how long each takes [s]
    times: int  # how many there are
    # how far each goes on from the one before [m]: x to the body's left, y up, z ahead
    drift: Vector = (0.0, 0.0, 0.0)

    @property
    def stop(self) -> float:
        """When the last time ends [s]."""
        return self.start + self.period * self.times


@dataclass(frozen=True)
class Gesture:
    """Something that people do mostly with their hands."""

    name: str  # in the words of the lexicon, or a new one
    texts: tuple[str, ...]  # sentences that say it, the fullest first; sides are those of the right hand
    keys: tuple[Key, ...]  # key poses in order of time; the first is where it begins and the last where it ends
    # seconds (start, end) that can be played again and again; None where it is done once
    cycle: tuple[float, float] | None = None
    steps: bool = False  # feet go where the keys say; else they stand all the time
    repeat: Repeat | None = None  # its single times, where it is done again and again and they can be counted
    handed: bool = False  # it is always done with these very hands: no person shakes hands with the left
    # the part of the body at which the right hand does it, of `catalogue.read_parts`; "" where it cannot be another
    at: str = ""
    begins: bool = False  # what comes before its cycle is always shown; else it may go on from the first moment

    @property
    def seconds(self) -> float:
        return self.keys[-1][0]

    @property
    def counted(self) -> bool:
        """Whether it can be done a number of times: its times are known, or it ends as it begins."""
        return self.repeat is not None or (self.cycle is None and self.onward is not None)

    @property
    def onward(self) -> Vector | None:
        """How far on it ends [m], in the pose in which it begins, as x, y and z of `Repeat`; None in another pose."""
        (_, first), (_, last) = self.keys[0], self.keys[-1]
        x, y, z = (end - start for start, end in zip(first.hips, last.hips, strict=True))
        there = moved(first, (x, 0.0, z))
        limbs = [math.dist(getattr(there, side).palm, getattr(last, side).palm) for side in ("right", "left")]
        limbs += [
            math.dist(getattr(there, foot).ankle, getattr(last, foot).ankle) for foot in ("right_foot", "left_foot")
        ]
        return None if max(*limbs, abs(y)) > SAME or abs(last.turn - first.turn) > 1 else (x, 0.0, z)


def again(
    poses: Sequence[Pose],
    period: float,
    times: int,
    *,
    start: float = 0.6,
    end: float = 0.6,
    rest: Pose | None = None,
    drift: Vector = (0.0, 0.0, 0.0),
) -> tuple[tuple[Key, ...], Repeat]:
    """Keys of a cycle that is repeated between two rests, and which of them are one time of it.

    Args:
        poses: Of one cycle, evenly in time; the first follows the last.
        period: Of a cycle [s].
        times: How many.
        start: Seconds from rest to the first pose.
        end: Seconds from the last pose to rest.
        rest: What it begins and ends with; standing with hanging arms for none.
        drift: How far each cycle goes on from the one before [m], as in `Repeat`.
    """
    rest = rest or Pose()
    keys: list[Key] = [(0.0, rest)]
    for cycle in range(times):
        here = [moved(pose, [cycle * step for step in drift]) for pose in poses]
        keys += [(start + period * (cycle + share / len(poses)), pose) for share, pose in enumerate(here)]
    over = start + period * times
    last, still = (moved(pose, [times * step for step in drift]) for pose in (poses[0], rest))
    keys += [(over, last), (over + end, still)]
    return tuple(keys), Repeat(start, period, times, (drift[0], drift[1], drift[2]))


def repeated_gesture(
    name: str, poses: Sequence[Pose], period: float, times: int, *, steps: bool = False, **how: Any
) -> Gesture:
    """A gesture whose poses are done again and again between two rests.

    Args:
        name: Of the gesture.
        poses: As in `again`.
        period: The same.
        times: The same.
        steps: Feet go where the poses say.
        how: `start`, `end`, `rest` and `drift` of `again`.
    """
    keys, repeat = again(poses, period, times, **how)
    return Gesture(name, (), keys, (repeat.start, repeat.stop - repeat.period), steps, repeat)


def moved(pose: Pose, by: Sequence[float]) -> Pose:
    """A pose further on: hips, feet, and hands on the ground."""
    if not any(by):
        return pose

    parts: dict[str, Any] = {}
    for side, sign in (("right", -1), ("left", 1)):
        outward = sign * by[0], by[1], by[2]
        hand, foot = getattr(pose, side), getattr(pose, f"{side}_foot")
        parts[side] = replace(hand, palm=added(hand.palm, outward)) if hand.on == "ground" else hand
        parts[f"{side}_foot"] = replace(foot, ankle=added(foot.ankle, outward))
    return replace(pose, hips=added(pose.hips, (by[0], by[1], by[2])), **parts)


def mirrored_pose(pose: Pose) -> Pose:
    """The mirror image of a pose."""
    lean, head = ((ahead, -left, -aside) for ahead, left, aside in (pose.lean, pose.head))
    x, y, z = pose.hips
    return replace(
        pose, right=pose.left, left=pose.right, right_foot=pose.left_foot, left_foot=pose.right_foot, hips=(-x, y, z),
        turn=-pose.turn, lean=lean, head=head,
    )  # fmt: skip


STEP = 1 / 20
"""Seconds between two poses."""
_BALL, _HEEL, _GROUND = (0.054, -0.155), (0.081, 0.05), 0.027
"""From ball and heel of the reference body's foot to its ankle, up and ahead, and the ball's height, measured [m]."""


def through(keys: Sequence[Key]) -> tuple[Key, ...]:
    """Poses each 0.05 s that pass through some others, smooth in position and speed; what two in a row share stays.

    Args:
        keys: Moments [s], in steps of 0.05, and what is reached then; hands are on the same all the time.
    """
    curve = MonotoneCurve([time for time, _ in keys], [_numbers(pose) for _, pose in keys])
    carriers, begin = (keys[0][1].right.on, keys[0][1].left.on), keys[0][0]
    moments = [begin + STEP * index for index in range(round((keys[-1][0] - begin) / STEP) + 1)]
    return tuple((round(moment, 3), _pose(iter(curve(moment).tolist()), carriers)) for moment in moments)


def foot_on(out: float, ahead: float, pitch: float = 0.0, turn: float = 8.0) -> Foot:
    """A foot on the ground, with its ball if the heel is up, and with its heel if the toes are.

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


def _numbers(pose: Pose) -> list[float]:
    numbers: list[float] = []
    for hand in (pose.right, pose.left):
        numbers += [*hand.palm, *_unit(hand.fingers), *_unit(hand.faces), *_unit(hand.elbow)]
    numbers += [*pose.lean, *pose.head, pose.shrug, *pose.hips, pose.turn, pose.tilt]
    for foot in (pose.right_foot, pose.left_foot):
        numbers += [*foot.ankle, foot.pitch, *foot.knee, foot.turn]
    return numbers


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
