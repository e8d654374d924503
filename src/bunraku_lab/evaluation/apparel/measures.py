"""What moving apparel is measured by: distances of vertices, lengths of edges, and what no network sees, the floors
that skinning alone can reach.
"""

from __future__ import annotations

import numpy as np

__all__ = ["edge_score", "oracle_skinning", "point_distance"]


def point_distance(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """PMD, the mean Euclidean distance of vertices from the truth in each frame [m], shapes (N, V, 3) -> (N,)."""
    return np.asarray(np.linalg.norm(points - truth, axis=-1).mean(axis=-1))


def edge_score(points: np.ndarray, rest: np.ndarray, edges: np.ndarray) -> float:
    """ELS, 1 less the mean change of an edge's length over its length at rest (Liao et al. 2022).

    Args:
        points: In N frames [m], shape (N, V, 3).
        rest: In the rest pose [m], shape (V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    before = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=-1)
    real = before > 1e-5
    edges, before = edges[real], before[real]
    if not len(edges):
        return 1.0
    now = np.linalg.norm(points[:, edges[:, 0]] - points[:, edges[:, 1]], axis=-1)
    return float(1 - np.abs(now / before - 1).mean())


def oracle_skinning(rest: np.ndarray, truth: np.ndarray, affine: np.ndarray, stride: int = 3) -> np.ndarray:
    """Vertices by the best static skinning weights that there are for these very frames, not negative and with a sum of
    1: no skinning network can do better. Shape (N, V, 3).

    Args:
        rest: In the rest pose [m], shape (V, 3).
        truth: In N frames [m], shape (N, V, 3).
        affine: Affine transforms of the joints, shape (N, J, 3, 4).
        stride: Every so many frames are fitted.
    """
    from scipy.optimize import nnls

    moved = np.einsum("njac,vc->vnaj", affine[..., :3], rest) + affine[..., 3].transpose(0, 2, 1)[None]
    out = np.empty_like(truth)
    for vertex, columns in enumerate(moved):
        some, target = columns[::stride].reshape(-1, affine.shape[1]), truth[::stride, vertex].reshape(-1)
        heavy = 100 * np.ones((1, affine.shape[1]))
        weights = nnls(np.concatenate([some, heavy]), np.append(target, 100.0), maxiter=1000)[0]
        out[:, vertex] = columns @ (weights / max(weights.sum(), 1e-9))
    return out
