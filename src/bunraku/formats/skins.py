"""Skin weights as files hold them, made whole: the strongest of each vertex, and some for those that have none."""

from __future__ import annotations

import numpy as np

__all__ = ["borrow_weights", "strongest"]


def strongest(
    points: np.ndarray, joints: np.ndarray, shares: np.ndarray, count: int, influences: int
) -> tuple[np.ndarray, np.ndarray]:
    """The largest shares of each vertex as a table, renormalised.

    Args:
        points: Vertex of each share, shape (S,).
        joints: Its joint, shape (S,).
        shares: The share, not negative, shape (S,).
        count: How many vertices there are, V.
        influences: Most joints of a vertex.

    Returns:
        Joints (V, M) and shares (V, M), largest first; rows sum to 1, or to 0 where a vertex has none.
    """
    order = np.lexsort((joints, -shares, points))
    points, joints, shares = points[order], joints[order], shares[order]
    rank = np.arange(len(points)) - np.searchsorted(points, np.arange(count))[points] if len(points) else points
    kept = (rank < influences) & (shares > 0)
    width = int(rank[kept].max(initial=0)) + 1
    indices, weights = np.zeros((count, width), np.int64), np.zeros((count, width))
    indices[points[kept], rank[kept]], weights[points[kept], rank[kept]] = joints[kept], shares[kept]
    total = weights.sum(axis=1, keepdims=True)
    return indices, weights / np.where(total > 0, total, 1)


def borrow_weights(vertices: np.ndarray, indices: np.ndarray, shares: np.ndarray, lost: np.ndarray) -> None:
    """Give vertices without weights those of the nearest vertex that has some; the first joint where none has.

    Args:
        vertices: Positions, shape (V, 3).
        indices: Joints, changed in place, shape (V, M).
        shares: Shares, changed in place, shape (V, M).
        lost: The vertices without weights.
    """
    good = np.flatnonzero(shares.sum(axis=1) > 1e-9)
    good = good[np.isfinite(vertices[good]).all(axis=1)]
    if not len(good):
        indices[lost], shares[lost] = 0, 0
        shares[lost, 0] = 1
        return
    from scipy.spatial import cKDTree

    nearest = good[cKDTree(vertices[good]).query(np.nan_to_num(vertices[lost]))[1]]
    indices[lost], shares[lost] = indices[nearest], shares[nearest]
