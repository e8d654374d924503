"""Filters along the first axis of an array, as `scipy.ndimage` has them for one axis, whose import takes as long as
numpy's.

Sums are in double precision and in the order of that package, and come back in the type that went in.
"""

from __future__ import annotations

import numpy as np

__all__ = ["correlated", "gaussian", "running_least", "running_mean", "running_most"]

EDGES = ("nearest", "mirror", "wrap")
CUT = 4.0
"""Deviations from its middle at which a Gaussian ends."""
_COLUMNS = 256  # at a time: few enough for the cache


def _padded(values: np.ndarray, before: int, after: int, edge: str) -> np.ndarray:
    """Values with more of them at both ends: the last one again and again ("nearest"), as in a mirror that stands on
    the last one ("mirror"), or from the other end ("wrap").
    """
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
    """Sums of neighbours in time with the weights of a kernel that is the same from both ends.

    Args:
        values: Shape (N, ...), floating.
        kernel: Of odd length.
        edge: What is beyond the ends: "nearest", "mirror" or "wrap".

    Returns:
        As `values`.
    """
    count, reach = len(values), len(kernel) // 2
    if count == 0:
        return values.copy()
    columns = values.reshape(count, -1)
    found = np.empty_like(columns)
    for first in range(0, columns.shape[1], _COLUMNS):
        some = np.asarray(columns[:, first : first + _COLUMNS], np.float64)
        longer = _padded(some, reach, reach, edge)
        out = longer[reach : reach + count] * kernel[reach]
        for away in range(reach, 0, -1):
            both = longer[reach - away : reach - away + count] + longer[reach + away : reach + away + count]
            both *= kernel[reach - away]
            out += both
        found[:, first : first + _COLUMNS] = out
    return found.reshape(values.shape)


def gaussian(values: np.ndarray, deviation: float, edge: str = "nearest") -> np.ndarray:
    """Values blurred in time.

    Args:
        values: Shape (N, ...), floating.
        deviation: Of the Gaussian [samples].
        edge: As of `correlated`.

    Returns:
        As `values`.
    """
    reach = int(CUT * float(deviation) + 0.5)
    kernel = np.exp(-0.5 / (deviation * deviation) * np.arange(-reach, reach + 1) ** 2)
    return correlated(values, kernel / kernel.sum(), edge)


def running_mean(values: np.ndarray, size: int) -> np.ndarray:
    """The mean of so many neighbours in time, the ends held, shape (N,) -> (N,)."""
    longer = _padded(np.asarray(values, np.float64), size // 2, size - size // 2 - 1, "nearest")
    first = np.cumsum(longer[:size])[-1:]
    return np.cumsum(np.concatenate([first, longer[size:] - longer[:-size]])) / size


def running_least(values: np.ndarray, size: int) -> np.ndarray:
    """The least of so many neighbours in time, shape (N,) -> (N,)."""
    longer = _padded(values, size // 2, size - size // 2 - 1, "nearest")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(longer, size).min(axis=-1))


def running_most(values: np.ndarray, size: int) -> np.ndarray:
    """The largest of so many neighbours in time, shape (N,) -> (N,)."""
    return -running_least(-values, size)
