"""A moving point set as few shapes: those of some frames, or those that the most of the movement is made of.

Both say the displacement of a frame as a sum of shapes by weights from 0 to 1, which all viewers take.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Shapes", "key_shapes", "mixed_shapes"]


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes and how much of each there is at what time.

    Args:
        shapes: Displacements [m], shape (T, M, 3), float32.
        frames: Frames that have keys, ascending, shape (F,); between them weights are linear.
        weights: Weights from 0 to 1, shape (F, T), float32.
    """

    shapes: np.ndarray
    frames: np.ndarray
    weights: np.ndarray

    @property
    def size(self) -> int:
        """About how many bytes they take in a file."""
        return self.shapes.nbytes + self.weights.nbytes

    def offsets(self, count: int) -> np.ndarray:
        """Displacements in each of `count` frames [m], shape (N, M, 3)."""
        weights = np.stack([np.interp(np.arange(count), self.frames, column) for column in self.weights.T], axis=1)
        return np.asarray(
            (weights.astype(np.float32) @ self.shapes.reshape(len(self.shapes), -1)).reshape(count, -1, 3)
        )


def key_shapes(offsets: np.ndarray, tolerance: float) -> Shapes:
    """The shapes of some frames, blended in straight lines from each to the next: never more than two at once.

    Args:
        offsets: Displacements of M points in N frames [m], shape (N, M, 3).
        tolerance: How far any point may be off in any frame [m].
    """
    last = len(offsets) - 1
    keys = [0]
    while keys[-1] < last:
        near, step = keys[-1] + 1, 1
        while near < last and _straight(offsets, keys[-1], min(keys[-1] + 2 * step, last), tolerance):
            step *= 2
            near = min(keys[-1] + step, last)
        far = min(keys[-1] + 2 * step, last)
        while far - near > 1:  # near can be reached, far cannot
            middle = (near + far) // 2
            near, far = (middle, far) if _straight(offsets, keys[-1], middle, tolerance) else (near, middle)
        keys.append(near)
    moving = [key for key in keys if np.abs(offsets[key]).max(initial=0) > 0.1 * tolerance]
    weights = np.zeros((len(keys), len(moving)), np.float32)
    for column, key in enumerate(moving):
        weights[keys.index(key), column] = 1
    return Shapes(np.ascontiguousarray(offsets[moving], np.float32), np.array(keys), weights)


def _straight(offsets: np.ndarray, first: int, last: int, tolerance: float) -> bool:
    """Whether the frames between two are near enough to the straight line between these."""
    if last - first < 2:
        return True
    share = (np.arange(first + 1, last) - first) / (last - first)
    line = offsets[first] + share[:, None, None].astype(np.float32) * (offsets[last] - offsets[first])
    return bool(((offsets[first + 1 : last] - line) ** 2).sum(axis=-1).max() <= tolerance**2)


def mixed_shapes(offsets: np.ndarray, tolerance: float) -> Shapes:
    """The fewest shapes that all frames are sums of, found by singular values: fewer than `key_shapes`, and all there
    in every frame.

    Their signs and sizes are such that weights run from 0 to 1; one more shape, always there in full, makes up for
    that.

    Args:
        offsets: As in `key_shapes`.
        tolerance: As in `key_shapes`.
    """
    count = len(offsets)
    flat = offsets.reshape(count, -1).astype(np.float64)
    middle = flat.mean(axis=0)
    away = flat - middle
    values, vectors = np.linalg.eigh(away @ away.T)  # N x N: clips have fewer frames than coordinates
    vectors = vectors[:, ::-1][:, values[::-1] > 1e-12 * max(float(values[-1]), 1e-30)]
    basis = vectors.T @ away  # rows orthogonal, largest first
    low, high = 0, vectors.shape[1]

    def near(rank: int) -> bool:
        left = (away - vectors[:, :rank] @ basis[:rank]).reshape(count, -1, 3)
        return bool((left**2).sum(axis=-1).max(initial=0) <= (0.98 * tolerance) ** 2)  # room for float32

    while low < high:
        rank = (low + high) // 2
        low, high = (low, rank) if near(rank) else (rank + 1, high)
    mix = vectors[:, :low]
    least, span = mix.min(axis=0), np.ptp(mix, axis=0)
    shapes = np.concatenate([(middle + least @ basis[:low])[None], span[:, None] * basis[:low]])
    weights = np.concatenate([np.ones((count, 1)), (mix - least) / np.maximum(span, 1e-30)], axis=1)
    return Shapes(
        shapes.reshape(len(shapes), -1, 3).astype(np.float32),
        np.arange(count),
        np.clip(weights, 0, 1).astype(np.float32),
    )
