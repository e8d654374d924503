"""The few vertices that reach farthest, among which is the lowest one in whatever way a body is turned."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

__all__ = ["extreme_points", "part_extremes"]

_GOLDEN = np.pi * (3 - np.sqrt(5))


@lru_cache(maxsize=8)
def _directions(count: int) -> np.ndarray:
    """Directions spread evenly over the sphere, shape (count, 3), float32."""
    number = np.arange(count)
    height = 1 - (2 * number + 1) / count
    radius = np.sqrt(1 - height**2)
    found = np.stack([radius * np.cos(_GOLDEN * number), height, radius * np.sin(_GOLDEN * number)], axis=1)
    return found.astype(np.float32)


def extreme_points(points: np.ndarray, count: int = 64) -> np.ndarray:
    """Indices, in order, of the points that reach farthest in each of `count` directions spread over the sphere.

    A point farther out in some direction than all of these is so by at most about a share 2 / count of its distance.

    Args:
        points: Shape (n, 3), n > 0.
        count: How many directions.
    """
    return np.unique((_directions(count) @ (points - points.mean(axis=0)).astype(np.float32).T).argmax(axis=1))


def part_extremes(vertices: np.ndarray, weights: np.ndarray, count: int = 160) -> np.ndarray:
    """Indices, in order, of the extreme points of every part of a body, shape (n,).

    Parts are the vertices that one handle moves more than the others do, and where a second one has a fair share, as at
    knees and elbows, those that the two move.

    Args:
        vertices: Rest positions, shape (V, 3).
        weights: Skinning weights, shape (V, K).
        count: How many directions for each part.
    """
    if len(vertices) == 0:
        return np.zeros(0, np.int64)
    most = weights.argmax(axis=1)
    shared = weights[np.arange(len(weights)), most] < 0.75
    label = most + weights.shape[1] * shared
    out = []
    for part in np.unique(label):
        own = np.flatnonzero(label == part)
        out.append(own if len(own) <= count else own[extreme_points(vertices[own], count)])
    return np.sort(np.concatenate(out))
