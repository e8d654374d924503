"""Key poses as arrays: a row for each key, so that all frames are posed at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.gestures.pose import HANGING, Foot, Hand, Key, Pose
from bunraku.gestures.standing import AT, SIDES

__all__ = ["CARRIERS", "FootTrack", "HandTrack", "Tracks"]

CARRIERS: dict[int, int | None] = {0: AT["head"], 1: AT["spine3"], 2: AT["pelvis"], 3: None}
"""The joint that carries a hand, by its number; none for the ground."""
_NUMBER = {"head": 0, "chest": 1, "hips": 2, "ground": 3}


@dataclass(frozen=True)
class HandTrack:
    """A hand in L key poses.

    Args:
        palm: Shape (L, 3) [m].
        ways: Unit vectors: where fingers point, where the palm faces, to where the elbow is bent, shape (L, 3, 3).
        on: What carries it (`CARRIERS`), shape (L,).
        rests: Whether it hangs as that of who only stands, shape (L,).
        raised: How far the shoulder goes up and ahead with it [degrees], shape (L, 2).
    """

    palm: np.ndarray
    ways: np.ndarray
    on: np.ndarray
    rests: np.ndarray
    raised: np.ndarray

    @classmethod
    def of(cls, hands: Sequence[Hand]) -> HandTrack:
        """The hands of some poses."""
        ways = np.array([[one.fingers, one.faces, one.elbow] for one in hands], float)
        return cls(
            np.array([one.palm for one in hands], float),
            ways / np.linalg.norm(ways, axis=-1, keepdims=True),
            np.array([_NUMBER[one.on] for one in hands]),
            np.array([replace(one, on=HANGING.on) == HANGING for one in hands]),
            np.array([_raised(one) for one in hands]),
        )


@dataclass(frozen=True)
class FootTrack:
    """A foot in L key poses.

    Args:
        ankle: Shape (L, 3) [m].
        knee: Direction to which the knee is bent, shape (L, 3).
        pitch: How far the heel is up over the toes, shape (L,) [degrees].
        turn: How far the toes point outwards, shape (L,) [degrees].
        rests: Whether it stands as that of who only stands, shape (L,).
    """

    ankle: np.ndarray
    knee: np.ndarray
    pitch: np.ndarray
    turn: np.ndarray
    rests: np.ndarray

    @classmethod
    def of(cls, feet: Sequence[Foot]) -> FootTrack:
        """The feet of some poses."""
        standing = Foot()
        return cls(
            np.array([one.ankle for one in feet], float),
            np.array([one.knee for one in feet], float),
            np.array([one.pitch for one in feet], float),
            np.array([one.turn for one in feet], float),
            np.array([one == standing for one in feet]),
        )


@dataclass(frozen=True)
class Tracks:
    """L key poses (`pose.Pose` says what the fields mean), shapes (L, 3) and (L,)."""

    lean: np.ndarray
    head: np.ndarray
    shrug: np.ndarray
    hips: np.ndarray
    turn: np.ndarray
    tilt: np.ndarray
    hands: dict[str, HandTrack]
    feet: dict[str, FootTrack]

    @classmethod
    def of(cls, keys: Sequence[Key]) -> Tracks:
        """The poses of some keys."""
        poses: list[Pose] = [pose for _, pose in keys]
        lean, head, shrug, hips, turn, tilt = (
            np.array([getattr(pose, name) for pose in poses], float)
            for name in ("lean", "head", "shrug", "hips", "turn", "tilt")
        )
        hands = {side: HandTrack.of([getattr(pose, side) for pose in poses]) for side, _ in SIDES}
        feet = {side: FootTrack.of([getattr(pose, f"{side}_foot") for pose in poses]) for side, _ in SIDES}
        return cls(lean, head, shrug, hips, turn, tilt, hands, feet)


def _raised(hand: Hand) -> tuple[float, float]:
    """How far a shoulder goes up and ahead with its hand [degrees]."""
    _, height, ahead = hand.palm
    if hand.on == "ground":
        return 0.0, 0.0
    return 18 * float(np.clip((height - 1.45) / 0.45, 0, 1)), 10 * float(np.clip((ahead - 0.3) / 0.4, 0, 1))
