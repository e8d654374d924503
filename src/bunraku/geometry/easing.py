"""Smooth ways from one value to another, and through several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["MonotoneCurve", "smooth_step"]


def smooth_step(values: np.ndarray, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """0 at `low` and beyond, 1 at `high`, and a rise between that is level at both ends; either may be the larger. Any
    shape.
    """
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))


class MonotoneCurve:
    """Cubics through points that never go beyond two neighbours (Fritsch & Butland 1984): SciPy's `PchipInterpolator`,
    without the module that it is in, whose import takes as long as a clip does.

    Args:
        times: Rising, shape (N,), N >= 2.
        points: Shape (N, C).
    """

    def __init__(self, times: Sequence[float] | np.ndarray, points: Sequence[Sequence[float]] | np.ndarray):
        self._times, self._points = np.asarray(times, float), np.asarray(points, float)
        self._gaps = np.diff(self._times)
        self._slopes = _slopes(self._gaps[:, None], np.diff(self._points, axis=0) / self._gaps[:, None])

    def __call__(self, times: float | np.ndarray) -> np.ndarray:
        """The points at some times, shape (...) -> (..., C); before the first and after the last the cubics go on."""
        at = np.asarray(times, float)
        piece = np.clip(np.searchsorted(self._times, at, side="right") - 1, 0, len(self._gaps) - 1)
        gap = self._gaps[piece]
        share = ((at - self._times[piece]) / gap)[..., None]
        first, last = self._points[piece], self._points[piece + 1]
        out, into = self._slopes[piece] * gap[..., None], self._slopes[piece + 1] * gap[..., None]
        rise = share * share * (3 - 2 * share)
        bend = share * (1 - share)
        return np.asarray(first + (last - first) * rise + bend * ((1 - share) * out - share * into))


def _slopes(gaps: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The slope at each point, of the time to the next one, shape (N - 1, 1), and the mean slope to it, (N - 1, C)."""
    if len(steps) == 1:
        return np.repeat(steps, 2, axis=0)
    before, after = steps[:-1], steps[1:]
    same = before * after > 0  # elsewhere a point is a peak, or its curve is level
    first, second = 2 * gaps[1:] + gaps[:-1], gaps[1:] + 2 * gaps[:-1]
    inverse = first / np.where(same, before, 1) + second / np.where(same, after, 1)
    inner = np.where(same, (first + second) / np.where(same, inverse, 1), 0.0)
    ends = (_end(gaps[0], gaps[1], steps[0], steps[1]), _end(gaps[-1], gaps[-2], steps[-1], steps[-2]))
    return np.concatenate([ends[0][None], inner, ends[1][None]])


def _end(near: np.ndarray, far: np.ndarray, step: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The slope at an end: that of a parabola, as far as it keeps the curve between its points."""
    slope = ((2 * near + far) * step - near * other) / (near + far)
    slope = np.where(slope * step <= 0, 0.0, slope)
    return np.where((step * other <= 0) & (np.abs(slope) > 3 * np.abs(step)), 3 * step, slope)
