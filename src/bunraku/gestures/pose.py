"""What a gesture is: a few key poses of the reference body, the flow through those that it does not stop at."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from bunraku.core.geometry.curves import MonotoneCurve

__all__ = [
    "Foot",
    "Gesture",
    "HANGING",
    "Hand",
    "Key",
    "Pose",
    "Repeat",
    "STEP",
    "again",
    "foot_on",
    "mirrored_pose",
    "moved",
    "repeated_gesture",
    "through",
    "vector",
]


Vector = tuple[float, float, float]
DOWN = (0.0, -1.0, 0.0)


def vector(values: np.ndarray) -> Vector:
    """Three numbers as a key pose keeps them."""
    x, y, z = np.asarray(values, float).tolist()
    return x, y, z


@dataclass(frozen=True)
class Hand:
    """Where a hand is and how it is held; if nothing else is said, as that of somebody who works at a table.

    Args:
        palm: Position of the middle of the palm.
        fingers: Direction in which the fingers point.
        faces: Direction in which the palm faces.
        elbow: Direction from the line between shoulder and wrist to the elbow.
        on: What carries the position: the "head", the "chest", the "hips", or the "ground", where it stays in the
            world.
    """

    palm: Vector
    fingers: Vector = (-0.3, 0.1, 1.0)
    faces: Vector = DOWN
    elbow: Vector = (0.6, -1.0, -0.3)
    on: Literal["head", "chest", "hips", "ground"] = "chest"


HANGING = Hand((0.27, 0.845, 0.06), (0.0, -1.0, 0.12), (-1.0, 0.0, 0.1), (0.35, 0.0, -1.0))
"""A hand of an arm that hangs."""


@dataclass(frozen=True)
class Foot:
    """Where a foot is.

    Args:
        ankle: Position of the ankle.
        pitch: How far the heel is up over the toes [degrees].
        knee: Direction to which the knee is bent.
        turn: How far the toes point outwards [degrees].
    """

    ankle: Vector = (0.12, 0.081, 0.0)
    pitch: float = 0.0
    knee: Vector = (0.15, 0.0, 1.0)
    turn: float = 8.0


@dataclass(frozen=True)
class Pose:
    """The body at one moment.

    Args:
        right: The right hand.
        left: The left hand.
        lean: Of the upper body: ahead, to the left about the vertical, to the right side [degrees].
        head: The same of the head, seen from the chest.
        shrug: How far both shoulders are up, 0 to 1.
        hips: Where the pelvis goes from where it is when somebody stands [m]: x to the body's left.
        turn: Of the pelvis to the left [degrees].
        right_foot: The right foot.
        left_foot: The left foot.
        tilt: Of the pelvis ahead: 90 for who lies on the belly, -90 on the back [degrees].
    """

    right: Hand = HANGING
    left: Hand = HANGING
    lean: Vector = (0.0, 0.0, 0.0)
    head: Vector = (0.0, 0.0, 0.0)
    shrug: float = 0.0
    hips: Vector = (0.0, 0.0, 0.0)
    turn: float = 0.0
    right_foot: Foot = field(default_factory=Foot)
    left_foot: Foot = field(default_factory=Foot)
    tilt: float = 0.0


Key = tuple[float, Pose]
"""A moment [s] and the pose that is reached then."""


@dataclass(frozen=True)
class Repeat:
    """Which of a gesture's keys are one time of what is done again and again.

    Args:
        start: When the first time begins [s].
        period: How long each takes [s].
        times: How many there are.
        drift: How far each goes on from the one before [m]: x to the body's left, y up, z ahead.
    """

    start: float
    period: float
    times: int
    drift: Vector = (0.0, 0.0, 0.0)

    @property
    def stop(self) -> float:
        """When the last time ends [s]."""
        return self.start + self.period * self.times


@dataclass(frozen=True)
class Gesture:
    """Something that people do mostly with their hands.

    Args:
        name: In the words of the lexicon, or a new one.
        texts: Sentences that tell it, the fullest first. Sides are the right one's.
        keys: Key poses in order of time; the first is where it begins and the last where it ends.
        cycle: Seconds (start, end) that can be played again and again; None where it is done once.
        steps: Feet go where the keys say; else they stand all the time.
        repeat: Its single times, where it is done again and again and they can be counted.
        handed: It is done with these very hands by everybody: nobody shakes hands with the left.
        at: The part of the body at which the right hand does it, where that may be another (`gestures.parts`); "" for
            none.
        begins: What comes before its cycle is always shown; else somebody may be at it from the first moment.
    """

    name: str
    texts: tuple[str, ...]
    keys: tuple[Key, ...]
    cycle: tuple[float, float] | None = None
    steps: bool = False
    repeat: Repeat | None = None
    handed: bool = False
    at: str = ""
    begins: bool = False

    @property
    def seconds(self) -> float:
        return self.keys[-1][0]

    @property
    def counted(self) -> bool:
        """Whether it can be done a number of times: its times are known, or it ends as it begins."""
        return self.repeat is not None or (self.cycle is None and self.keys[0][1] == self.keys[-1][1])


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
    """Keys of something that is done again and again between two rests, and which of them are one time of it.

    Args:
        poses: Of one cycle, evenly in time; the first follows the last.
        period: Of a cycle [s].
        times: How many.
        start: Seconds from standing with hanging arms to the first pose.
        end: Seconds from the last pose to that again.
        rest: What it begins and ends with in place of hanging arms.
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
    x, y, z = drift
    return tuple(keys), Repeat(start, period, times, (x, y, z))


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

    def on(position: Sequence[float], side: int) -> Vector:
        return position[0] + side * by[0], position[1] + by[1], position[2] + by[2]

    def hand(one: Hand, side: int) -> Hand:
        return replace(one, palm=on(one.palm, side)) if one.on == "ground" else one

    return replace(
        pose, hips=on(pose.hips, 1), right=hand(pose.right, -1), left=hand(pose.left, 1),
        right_foot=replace(pose.right_foot, ankle=on(pose.right_foot.ankle, -1)),
        left_foot=replace(pose.left_foot, ankle=on(pose.left_foot.ankle, 1)),
    )  # fmt: skip


def mirrored_pose(pose: Pose) -> Pose:
    """The mirror image of a pose."""
    lean, head = ((ahead, -left, -aside) for ahead, left, aside in (pose.lean, pose.head))
    x, y, z = pose.hips
    return replace(
        pose, right=pose.left, left=pose.right, right_foot=pose.left_foot, left_foot=pose.right_foot, hips=(-x, y, z),
        turn=-pose.turn, lean=lean, head=head,
    )  # fmt: skip


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
