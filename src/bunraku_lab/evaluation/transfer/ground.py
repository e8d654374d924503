"""Whether a character stands on its ground: how far its lowest point is off it, leaps left out."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import minimum_filter1d

from bunraku.core.animation import Animation

__all__ = ["ground_heights", "off_ground"]

LEAP = 0.6
"""Who is in the air for no longer leaps [s]; runs of animals do so at every stride."""
CHUNK = 64  # frames posed at once: bounds memory


def ground_heights(animation: Animation) -> np.ndarray:
    """Height of the lowest vertex over the ground in each frame, over the character's height, shape (N,).

    The ground is where the lowest point of the rest pose is. Vertices without faces do not count.
    """
    character = animation.character
    seen = character.surface
    floor = float(character.vertices[seen, 1].min())
    frames = np.arange(len(animation.motion))
    lows = [
        animation.vertices(frames[start : start + CHUNK])[:, seen, 1].min(axis=1)
        for start in range(0, len(frames), CHUNK)
    ]
    return np.asarray((np.concatenate(lows) - floor) / character.height)


def off_ground(heights: np.ndarray, fps: float) -> float:
    """How far a body is off its ground at the most, over its height: how deep it sinks, or how high it hovers for
    longer than a leap lasts.

    Args:
        heights: Of the lowest point, as of `ground_heights`, shape (N,).
        fps: Frames a second [1/s].
    """
    window = 2 * round(0.5 * LEAP * fps) + 1
    hovers = minimum_filter1d(heights, window, mode="nearest")
    return float(max(-heights.min(), hovers.max(), 0.0))
