"""The frames of a clip in which a body stands: the tallest ones that last."""

from __future__ import annotations

import numpy as np

from bunraku.geometry.filters import running_mean

__all__ = ["tallest_steady"]

STRIDE = 0.5
"""Heights are means over so long, in which a stride goes up and down [s]."""
QUANTILE = 0.9
"""A leap or a rearing up that is shorter than a tenth of the clip is not what a body stands as."""


def tallest_steady(heights: np.ndarray, fps: float, tall: float = 0.9, fast: float = 0.5) -> np.ndarray:
    """In which frames a body is about as tall as it lastingly is, shape (N,), bool; at least one.

    Who sits, crouches or lies at first is lower there than later.

    Args:
        heights: How tall it is in each frame, any unit, shape (N,).
        fps: Frames a second [1/s].
        tall: Frames count that have so much of the height that a tenth of the steady ones have.
        fast: In a steady frame the height changes by no larger share of it in a second [1/s].
    """
    heights = running_mean(np.asarray(heights, np.float64), max(round(STRIDE * fps), 1))
    change = np.abs(np.gradient(heights)) * fps if len(heights) > 1 else np.zeros(len(heights))
    steady = change <= fast * np.maximum(heights, 0)
    if not steady.any():
        steady[:] = True
    return np.asarray(steady & (heights >= tall * np.quantile(heights[steady], QUANTILE)))
