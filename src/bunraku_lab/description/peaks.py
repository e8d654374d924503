"""Peaks of a curve."""

from __future__ import annotations

import numpy as np

__all__ = ["peaks"]


def peaks(values: np.ndarray, prominence: float, height: float | None = None) -> np.ndarray:
    """Where a curve has peaks, shape (P,).

    Args:
        values: Shape (N,).
        prominence: By how much they stand out at the least.
        height: How high they are at the least.
    """
    from scipy.signal import find_peaks  # which loads half of scipy, a second that not all who read this file need

    return np.asarray(find_peaks(values, height=height, prominence=prominence)[0])
