"""Weighted rigid registration of all parts in all frames at once (Besl & McKay 1992).

A part k is the column k of a weight matrix. Its handle h_k is the weighted mean of the rest vertices, and its motion in
a frame is the rotation R and translation t that bring `R (x - h_k) + h_k + t` closest to the moved vertices in the
sense of weighted least squares. This is the form of the local transforms of Eq. 3 of TapMo.

The covariances of all parts and frames are one matrix product; the rotations are one batch of 3x3 singular value
decompositions with the sign of the last singular value set so that no part is mirrored. Everything is in double
precision inside.

Parts that do not fix a rotation (one point, points on one line) take the solution nearest to the identity: a tiny
multiple of the identity is added to the covariance, far below what a proper part has. A part without weight does not
turn and follows the mean of all vertices.
"""

from __future__ import annotations

import numpy as np

__all__ = ["EMPTY", "PULL", "part_means", "register", "register_reference"]

PULL = 1e-8
"""Share of the part's own variance by which the covariance is pulled to the identity."""
EMPTY = 1e-9
"""Mean weight under which a part counts as empty."""


def _shares(weights: np.ndarray) -> np.ndarray:
    """Columns that sum to 1, shape (V, K), float64; a column without weight becomes the plain mean."""
    weights = np.asarray(weights, np.float64)
    total = weights.sum(axis=0)
    empty = total <= EMPTY * len(weights)
    return np.where(empty, 1 / len(weights), weights / np.where(empty, 1, total))


def part_means(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted means of the vertices: the centres of the parts, which section 3.1 of TapMo takes for handle positions.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        weights: Skinning weights, shape (V, K).

    Returns:
        Means h [m], shape (K, 3), float64. A part without weight has the mean of all vertices.
    """
    return _shares(weights).T @ np.asarray(vertices, np.float64)


def register(
    source: np.ndarray, targets: np.ndarray, weights: np.ndarray, handles: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion of every part in every frame (Besl & McKay 1992).

    Args:
        source: Rest vertices x [m], shape (V, 3).
        targets: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Skinning weights, not negative, shape (V, K).
        handles: Positions h [m] about which the motions are expressed, shape (K, 3); the weighted means of the source
            (`part_means`) when not given.

    Returns:
        Rotations R (N, K, 3, 3) and translations t (N, K, 3) [m], float64: a point x of part k goes to `R (x - h_k) +
        h_k + t`.
    """
    source = np.asarray(source, np.float64)
    frames, count = len(targets), weights.shape[1]
    shares = _shares(weights)
    means = shares.T @ source
    arms = source[:, None] - means  # (V, K, 3)
    empty = np.asarray(weights, np.float64).sum(axis=0) <= EMPTY * len(source)
    basis = np.empty((len(source), 4, count))
    basis[:, :3] = (arms * shares[..., None]).transpose(0, 2, 1)
    basis[:, 3] = shares
    variance = (arms * arms).sum(-1)
    spread = np.einsum("vk,vk->k", variance, shares)

    middle = source.mean(axis=0)
    moved = np.ascontiguousarray((np.asarray(targets, np.float64) - middle).transpose(0, 2, 1))
    sums = (moved.reshape(3 * frames, -1) @ basis.reshape(len(source), -1)).reshape(frames, 3, 4, count)
    moved_means = sums[:, :, 3].transpose(0, 2, 1) + middle  # (N, K, 3)
    covariance = sums[:, :, :3].transpose(0, 3, 1, 2).copy()  # (N, K, target axis, source axis)
    covariance[:, empty] = 0
    covariance += (PULL * spread + (spread <= 0))[:, None, None] * np.eye(3)

    u, _, vt = np.linalg.svd(covariance)
    u[..., 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotations = u @ vt
    origin = means if handles is None else np.asarray(handles, np.float64)
    translations = moved_means - origin - np.einsum("nkij,kj->nki", rotations, means - origin)
    return rotations, translations


def register_reference(
    source: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`register` of one part in one frame as the paper has it.

    Args:
        source: Rest vertices [m], shape (V, 3).
        target: Moved vertices [m], shape (V, 3).
        weight: The part's weights, shape (V,), not all zero; the points must not lie on one line.

    Returns:
        Handle h (3,), rotation R (3, 3) and translation t (3,).
    """
    handle = np.average(source, axis=0, weights=weight)
    middle = np.average(target, axis=0, weights=weight)
    covariance = np.zeros((3, 3))
    for x, y, w in zip(source, target, weight, strict=True):
        covariance += w * np.outer(y - middle, x - handle)
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return handle, rotation, middle - handle
