"""Skeletal motions at another rate, and parts of them."""

from __future__ import annotations

import math

from bunraku.core.motion import SkeletalMotion
from bunraku.errors import MotionError
from bunraku.geometry.resampling import Resampling

__all__ = ["cut_motion", "resample_motion"]


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
    return SkeletalMotion(motion.skeleton, between.rotations(motion.rotations), between.linear(motion.root_translation.astype(float)), fps)


def cut_motion(motion: SkeletalMotion, start: float, end: float) -> SkeletalMotion:
    """The frames from one time to another [s]; what lies outside the motion is left out.

    Raises:
        MotionError: No frame is left.
    """
    first, stop = max(round(start * motion.fps), 0), min(round(end * motion.fps), len(motion))
    if stop <= first:
        raise MotionError(f"no frame lies between {start:g} s and {end:g} s of a motion of {len(motion) / motion.fps:.2f} s")
    return SkeletalMotion(motion.skeleton, motion.rotations[first:stop], motion.root_translation[first:stop], motion.fps)
