"""Skeletal motions at another rate, and parts of them."""

from __future__ import annotations

import math
from dataclasses import replace

from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import MotionError, OptionError
from bunraku.geometry.resampling import Resampling

__all__ = ["checked_fps", "cut_motion", "resample", "resample_motion"]


def resample_motion(motion: SkeletalMotion, fps: float) -> SkeletalMotion:
    """A skeletal motion at another rate: rotations turn the short way between frames, the root moves in straight lines.

    Args:
        motion: At least one frame.
        fps: Frames a second of the result [1/s].

    Returns:
        The frames that lie within the duration; the motion itself where the rate is the same.

    Raises:
        MotionError: The rate is not positive.
    """
    if not 0 < fps < math.inf:
        raise MotionError("frames a second must be positive and finite")
    if abs(motion.fps - fps) < 1e-6 * fps:
        return motion
    between = Resampling.of(len(motion), motion.fps, fps)
    return SkeletalMotion(
        motion.skeleton, between.rotations(motion.rotations), between.linear(motion.root_translation.astype(float)), fps
    )


def cut_motion(motion: SkeletalMotion, start: float, end: float) -> SkeletalMotion:
    """The frames from one time to another [s]; what lies outside the motion is left out.

    Raises:
        MotionError: No frame is left.
    """
    first, stop = max(round(start * motion.fps), 0), min(round(end * motion.fps), len(motion))
    if stop <= first:
        raise MotionError(
            f"no frame lies between {start:g} s and {end:g} s of a motion of {len(motion) / motion.fps:.2f} s"
        )
    return SkeletalMotion(
        motion.skeleton, motion.rotations[first:stop], motion.root_translation[first:stop], motion.fps
    )


def checked_fps(fps: float | None, default: float) -> float:
    """Frames a second of an output [1/s].

    Raises:
        OptionError: They are not a number from 1 to 1000.
    """
    if fps is None:
        return float(default)
    try:
        value = float(fps)
    except (TypeError, ValueError):
        raise OptionError(f"fps must be a number from 1 to 1000, not {fps!r}") from None
    if not 1 <= value <= 1000:
        raise OptionError(f"fps must be a number from 1 to 1000, not {fps!r}")
    return value


def resample(motion: HandleMotion, fps: float) -> HandleMotion:
    """The motion at another frame rate: translations linear, rotations along the shortest arc.

    Args:
        motion: The motion, frame n at n / motion.fps seconds.
        fps: Frames a second of the result [1/s]; frame m is at m / fps seconds, as far as the motion reaches.
    """
    if abs(fps - motion.fps) < 1e-6 or len(motion) == 1:
        return motion if len(motion) > 1 else replace(motion, fps=fps)
    between = Resampling.of(len(motion), motion.fps, fps)
    moves, path = (between.linear(values.astype(float)) for values in (motion.translations, motion.root_translation))
    return replace(
        motion, translations=moves, rotations=between.rotations(motion.rotations), root_translation=path,
        root_rotation=between.rotations(motion.root_rotation), fps=fps,
    )  # fmt: skip
