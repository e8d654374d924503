"""Smooth ways from one value to another."""

from __future__ import annotations

import numpy as np

__all__ = ["smooth_step"]


def smooth_step(values: np.ndarray, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """0 at `low` and beyond, 1 at `high`, and a rise between that is level at both ends; either may be the larger. Any
    shape.
    """
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))
