"""A path drawn on the ground, for a root to follow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.core.request.constraint import Constraint
from bunraku.errors import OptionError
from bunraku.geometry.easing import MonotoneCurve
from bunraku.geometry.filters import gaussian

__all__ = ["GroundPath", "bent_to_path"]

MOST = 200
DENSE = 64
"""Places that stand for the curve between two points."""
LONGEST = 500.0
"""Metres of a path, and from the origin along an axis."""
SWAY = 0.3
"""Seconds: what a root does faster than this is its own, not the path's."""
ASIDE = 0.05
"""How far the root may sway off the path, over the height of the root handle."""


@dataclass(frozen=True)
class GroundPath(Constraint):
    """Points on the ground that a root passes.

    Args:
        points: x and z of each [m], at least two that differ.
        times: When it passes each [s], rising from 0; None goes the whole way evenly, setting off and arriving softly.

    Raises:
        OptionError: Fewer than two points, times that do not rise, or numbers that make no sense.
    """

    points: tuple[tuple[float, float], ...]
    times: tuple[float, ...] | None = None

    kind: ClassVar[str] = "path"
    alone: ClassVar[tuple[tuple[str, ...], str]] = (
        ("loop", "after", "in_place"),
        "a path says where the character goes, so it goes with none of {1}, {2} and {3}",
    )

    def __post_init__(self) -> None:
        points = np.asarray(self.points, float)
        if (
            points.ndim != 2
            or points.shape[1:] != (2,)
            or not 2 <= len(points) <= MOST
            or not np.isfinite(points).all()
        ):
            raise OptionError(f"a path has 2 to {MOST} points, each with x and z in metres, such as 0,0 1,2 3,2")
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if not 1e-6 < length <= LONGEST:
            raise OptionError(f"a path is longer than nothing and at most {LONGEST:g} m, not {length:g} m")
        if self.times is not None:
            times = np.asarray(self.times, float)
            if (
                len(times) != len(points)
                or not np.isfinite(times).all()
                or times[0] != 0
                or (np.diff(times) <= 0).any()
            ):
                raise OptionError("the times of a path rise from 0, one for each of its points")

    def moved(self, scale: float) -> GroundPath:
        """The same path in another unit."""
        return GroundPath(tuple((x * scale, z * scale) for x, z in self.points), self.times)

    def positions(self, frames: int, fps: float) -> np.ndarray:
        """Where the root is in each frame [m], shape (N, 2).

        Raises:
            OptionError: The path's last time is after the end of the clip.
        """
        points = np.asarray(self.points, float)
        seconds = max((frames - 1) / fps, 1e-9)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate([[True], steps > 1e-9])
        if self.times is not None:
            if self.times[-1] > seconds + 1 / fps:
                raise OptionError(
                    f"the path ends at {self.times[-1]:g} s, after the end of the clip, {frames / fps:g} s"
                )
            knots = np.asarray(self.times)
            now = np.minimum(np.arange(frames) / fps, knots[-1])
            return MonotoneCurve(knots, points)(now)
        points = points[keep]
        along = np.concatenate([[0.0], np.cumsum(steps[steps > 1e-9])])
        curve = MonotoneCurve(along, points)(np.linspace(0, along[-1], DENSE * len(points)))
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
        soft = min(0.4, seconds / 4)  # s to set off and to arrive
        time = np.arange(frames) / fps
        speed = np.clip(np.minimum(time, seconds - time) / soft, 0, 1)
        velocity = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * length[-1]
        velocity /= max(float(speed.sum()) - 0.5 * float(speed[0] + speed[-1]), 1e-9)
        return np.column_stack([np.interp(velocity, length, column) for column in curve.T])

    def headings(self, frames: int, fps: float, backwards: bool = False) -> np.ndarray:
        """Where who follows the path looks in each frame [rad], shape (N,): along it, or back; 0 is +Z, positive turns
        towards +X.
        """
        positions = self.positions(frames, fps)
        velocity = np.gradient(positions, axis=0) if frames > 1 else np.zeros_like(positions)
        speed = np.linalg.norm(velocity, axis=1)
        moves = np.flatnonzero(speed > 1e-3 * max(float(speed.max()), 1e-12))
        angle = np.unwrap(np.arctan2(velocity[moves, 0], velocity[moves, 1]))
        whole = np.interp(np.arange(frames), moves, angle)
        return np.asarray(gaussian(whole, 0.15 * fps) + (math.pi if backwards else 0.0))


def bent_to_path(
    motion: HandleMotion, path: GroundPath, start: Sequence[float] = (0.0, 0.0), size: float = 1.0
) -> HandleMotion:
    """The motion whose root, but for its sway, is on the path at its time.

    Args:
        motion: Of the character, N frames.
        path: In its metres.
        start: What of the path is at the root of a character that stands at the origin [m].
        size: Height of its root handle [m], for how far it may sway.
    """
    want = path.positions(len(motion), motion.fps) + np.asarray(start, float)
    root = motion.root_translation.astype(float)
    off = root[:, [0, 2]] - want
    sway = off - gaussian(off, SWAY * motion.fps)
    far = np.linalg.norm(sway, axis=1, keepdims=True) / (ASIDE * size)
    sway *= np.tanh(far) / np.maximum(far, 1e-9)
    root[:, [0, 2]] = want + sway
    return replace(motion, root_translation=root)
