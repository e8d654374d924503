"""Gestures at another part of the body: who scratches the head can scratch the chin, the neck and a knee so, too."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bunraku.gestures.catalogue import read_parts
from bunraku.gestures.pose import HANGING, Gesture, Hand, Pose

__all__ = ["Part", "at_part", "part_in"]


class Part(NamedTuple):
    """A part of the body that a sentence names.

    Args:
        name: Of `[parts]` in `gestures.toml`.
        words: Those of the sentence that say it.
    """

    name: str
    words: tuple[str, ...]


def part_in(text: str) -> Part | None:
    """The part of the body that a text names, by the most words; None where it names none that a hand reaches."""
    words = re.findall(r"[a-z]+", text.lower())
    found = [
        Part(name, tuple(words[start : start + len(phrase)]))
        for name, phrase in _phrases()
        for start in range(len(words) - len(phrase) + 1)
        if all(word in choice for word, choice in zip(words[start:], phrase, strict=False))
    ]
    return max(found, key=lambda one: len(one.words), default=None)


@functools.cache
def _phrases() -> tuple[tuple[str, tuple[frozenset[str], ...]], ...]:
    """The phrases of all parts: at each place the words that may stand there."""
    return tuple(
        (name, tuple(frozenset(choice.split("/")) for choice in phrase.split()))
        for name, (said, _) in read_parts().items()
        for phrase in said.split(", ")
    )


@functools.lru_cache(maxsize=64)
def at_part(gesture: Gesture, name: str) -> Gesture:
    """A gesture of the right hand done at another part of the body: its movement along the surface there, and the body
    bent as far as the hand has to reach.

    Args:
        gesture: With an `at` of its own.
        name: Of the part.
    """
    own, there = (read_parts()[one][1] for one in (gesture.at, name))
    turn = _frame(there.right) @ _frame(own.right).T

    def moved(pose: Pose) -> Pose:
        if replace(pose.right, on=HANGING.on) == HANGING:
            return pose
        away = turn @ (np.array(pose.right.palm) - own.right.palm)
        palm = tuple((np.array(there.right.palm) + away).tolist())
        lean, head, hips = (_sum(getattr(pose, part), getattr(there, part)) for part in ("lean", "head", "hips"))
        return replace(pose, right=replace(there.right, palm=palm), lean=lean, head=head, hips=hips)

    return replace(gesture, keys=tuple((time, moved(pose)) for time, pose in gesture.keys), at=name)


def _frame(hand: Hand) -> np.ndarray:
    """Axes of a hand: along the fingers, out of the palm, across both."""
    along = np.array(hand.fingers) / np.linalg.norm(hand.fingers)
    out = np.array(hand.faces) - along * (along @ np.array(hand.faces))
    out /= np.linalg.norm(out)
    return np.stack([along, out, np.cross(along, out)], axis=1)


def _sum(one: Sequence[float], other: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (a + b for a, b in zip(one, other, strict=True))
    return x, y, z
