"""Curves in time: filters along frames, smooth transitions, banded systems, and the frames in which a body stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

EDGES = ("nearest", "mirror", "wrap")
CUT = 4.0
"""Deviations from its middle at which a Gaussian ends."""
_COLUMNS = 256  # at a time: few enough for the cache


def _padded(values: np.ndarray, before: int, after: int, edge: str) -> np.ndarray:
    """Values continued at both ends by the last one ("nearest"), its mirror ("mirror") or the other end ("wrap")."""
    last = len(values) - 1
    index = np.arange(-before, last + 1 + after)
    if edge == "nearest":
        index = np.clip(index, 0, last)
    elif edge == "mirror":
        index = np.abs((index + last) % max(2 * last, 1) - last)
    elif edge == "wrap":
        index %= last + 1
    else:
        raise ValueError(f"the edge {edge!r} is unknown; there are {', '.join(EDGES)}")
    return values[index]


def correlated(values: np.ndarray, kernel: np.ndarray, edge: str = "nearest") -> np.ndarray:
    """Weighted sums of neighbours in time, shape (N, ...), floating, by a symmetric kernel of odd length; `edge` is
    "nearest", "mirror" or "wrap".
    """
    count, reach = len(values), len(kernel) // 2
    if count == 0:
        return values.copy()
    columns = values.reshape(count, -1)
    filtered = np.empty_like(columns)
    for first in range(0, columns.shape[1], _COLUMNS):
        chunk = np.asarray(columns[:, first : first + _COLUMNS], np.float64)
        longer = _padded(chunk, reach, reach, edge)
        out = longer[reach : reach + count] * kernel[reach]
        for away in range(reach, 0, -1):
            both = longer[reach - away : reach - away + count] + longer[reach + away : reach + away + count]
            both *= kernel[reach - away]
            out += both
        filtered[:, first : first + _COLUMNS] = out
    return filtered.reshape(values.shape)


def gaussian(values: np.ndarray, deviation: float, edge: str = "nearest") -> np.ndarray:
    """Values blurred in time, shape (N, ...), by a Gaussian of this deviation [samples]; `edge` as in `correlated`."""
    reach = int(CUT * float(deviation) + 0.5)
    kernel = np.exp(-0.5 / (deviation * deviation) * np.arange(-reach, reach + 1) ** 2)
    return correlated(values, kernel / kernel.sum(), edge)


def running_mean(values: np.ndarray, size: int) -> np.ndarray:
    """The mean of `size` neighbours in time, the ends held, shape (N,) -> (N,)."""
    longer = _padded(np.asarray(values, np.float64), size // 2, size - size // 2 - 1, "nearest")
    first = np.cumsum(longer[:size])[-1:]
    return np.cumsum(np.concatenate([first, longer[size:] - longer[:-size]])) / size


def running_least(values: np.ndarray, size: int) -> np.ndarray:
    """The least of `size` neighbours in time, shape (N,) -> (N,)."""
    longer = _padded(values, size // 2, size - size // 2 - 1, "nearest")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(longer, size).min(axis=-1))


def running_most(values: np.ndarray, size: int) -> np.ndarray:
    """The largest of `size` neighbours in time, shape (N,) -> (N,)."""
    return -running_least(-values, size)


def softly_bounded(vectors: np.ndarray, most: float) -> np.ndarray:
    """Vectors (N, D) in the same directions, none longer than `most`; those that are much shorter hardly change."""
    far = np.linalg.norm(vectors, axis=1, keepdims=True) / most
    return np.asarray(vectors * np.tanh(far) / np.maximum(far, 1e-9))


def smooth_step(values: np.ndarray, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """0 up to `low`, 1 from `high` on, and a rise that is level at both ends; either may be the larger. Any shape."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return np.asarray(share * share * (3 - 2 * share))


class MonotoneCurve:
    """Cubics through points that never overshoot (Fritsch & Butland 1984): SciPy's `PchipInterpolator` without its
    module, whose import takes as long as a clip does.

    Args:
        times: Rising, shape (N,), N >= 2.
        points: Shape (N, C).
    """

    def __init__(self, times: Sequence[float] | np.ndarray, points: Sequence[Sequence[float]] | np.ndarray):
        self._times, self._points = np.asarray(times, float), np.asarray(points, float)
        self._gaps = np.diff(self._times)
        self._slopes = _slopes(self._gaps[:, None], np.diff(self._points, axis=0) / self._gaps[:, None])

    def __call__(self, times: float | np.ndarray) -> np.ndarray:
        """The points at some times, shape (...) -> (..., C); beyond the ends the cubics go on."""
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
    """Slope at each point, from the time to the next one, shape (N - 1, 1), and the mean slope to it, (N - 1, C)."""
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


BLOCK = 48
"""Unknowns that are eliminated at once, by a dense matrix."""


def solve_banded(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve A x = b for a symmetric positive definite A of 2 u + 1 diagonals, block by block; x has shape (N, C),
    float64. numpy.linalg.LinAlgError if a is singular.

    Args:
        band: The upper diagonals as in `scipy.linalg.solveh_banded`: A[i, i + d] stands at [u - d, i + d]; shape (u +
            1, N).
        right: b, shape (N, C).
    """
    above, count = len(band) - 1, band.shape[1]
    size = max(BLOCK, above)
    more = -count % size  # unknowns that are 0, so that all blocks are alike
    band = np.pad(np.asarray(band, np.float64), ((0, 0), (0, more + size)))
    band[above, count:] = 1
    out = np.pad(np.asarray(right, np.float64), ((0, more), (0, 0)))
    rows, shared = np.arange(size), np.zeros((above, above))
    taken: list[np.ndarray] = []  # what each block takes from the next one's first unknowns
    for start in range(0, len(out), size):
        block = np.zeros((size, size + above))
        for away in range(above + 1):
            block[rows, rows + away] = band[above - away, start + rows + away]
        inner, outer = block[:, :size], block[:, size:]
        inner += np.triu(inner, 1).T
        if start:  # the block before ends in what its last unknowns and these share
            inner[:above, :above] -= shared.T @ taken[-1][-above:]
            out[start : start + above] -= shared.T @ out[start - above : start]
        solved = np.linalg.solve(inner, np.concatenate([outer, out[start : start + size]], axis=1))
        taken.append(solved[:, :above])
        out[start : start + size] = solved[:, above:]
        shared = outer[-above:]
    for start in range(len(out) - 2 * size, -1, -size):
        out[start : start + size] -= taken[start // size] @ out[start + size : start + size + above]
    return out[:count]


STRIDE = 0.5
"""Heights are averaged over this time [s], that of a stride: people take about two steps a second (Murray 1964)."""
STANDS = 0.05
"""Share of the frames whose lowest point may be under the ground where a motion is set on it."""
QUANTILE = 0.9
"""A leap or a rearing that is shorter than a tenth of the clip is, by definition, not how tall a body stands."""


def tallest_steady(heights: np.ndarray, fps: float, tall: float = 0.9, fast: float = 0.5) -> np.ndarray:
    """Frames in which a body is about as tall as it lastingly is, shape (N,), bool; at least one. A character that
    sits, crouches or lies at first is lower there than later.

    Args:
        heights: Height in each frame, any unit, shape (N,).
        fps: Frames a second [1/s].
        tall: Least share of the height that a tenth of the steady frames reach.
        fast: Largest change of the height in a steady frame, as a share of it [1/s].
    """
    heights = running_mean(np.asarray(heights, np.float64), max(round(STRIDE * fps), 1))
    change = np.abs(np.gradient(heights)) * fps if len(heights) > 1 else np.zeros(len(heights))
    steady = change <= fast * np.maximum(heights, 0)
    if not steady.any():
        steady[:] = True
    return np.asarray(steady & (heights >= tall * np.quantile(heights[steady], QUANTILE)))
