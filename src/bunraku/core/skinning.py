"""Eq. 3 of TapMo, its only home: the affine transforms of handles, and linear blend skinning of all frames as one
matrix product.

`v' = R_g (sum_k s_k (R_k (v - h_k) + h_k + t_k) - h_0) + h_0 + t_g`. Handle 0 is the root and has the identity as its
local transform, so its share of the weights is not lost. The readable reference of the product stands beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["handle_offsets", "posed_points", "skin", "skin_reference"]

Array = Any  # numpy.ndarray, or a tensor


def _product(matrices: Array, points: Array) -> Array:
    if isinstance(matrices, np.ndarray):
        return np.einsum("...ij,...j->...i", matrices, points)
    return (matrices @ points[..., None])[..., 0]


def handle_offsets(positions: Array, translations: Array, rotations: Array) -> Array:
    """What a handle's local transform adds to a rotated vertex, `R (v - h) + h + t = R v + (h + t - R h)`; numpy arrays
    or tensors.

    Args:
        positions: Rest positions h of the handles [m], shape (..., K, 3).
        translations: Local translations t [m], shape (..., K, 3).
        rotations: Local rotations R, shape (..., K, 3, 3).

    Returns:
        Shape (..., K, 3).
    """
    return positions + translations - _product(rotations, positions)


def posed_points(transforms: Array, points: Array) -> Array:
    """Where affine transforms take a point each, `A p + b`; numpy arrays or tensors.

    Args:
        transforms: [A | b], shape (..., K, 3, 4).
        points: Rest positions [m], shape (..., K, 3).

    Returns:
        Shape (..., K, 3).
    """
    return _product(transforms[..., :3], points) + transforms[..., 3]


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Blend-skin every vertex in every frame [TapMo 3] as one GEMM, (3N, 4K) @ (4K, V).

    Args:
        vertices: Rest positions [m], shape (V, 3).
        weights: Skinning weights, shape (V, K).
        transforms: Affine transform of each handle, shape (N, K, 3, 4).

    Returns:
        Posed positions [m], shape (N, V, 3), float32: a view with coordinates apart, `result[n]` is cheap to make
        contiguous.
    """
    frames, count = transforms.shape[:2]
    basis = skin_basis(vertices, weights)
    left = np.ascontiguousarray(np.asarray(transforms, np.float32).transpose(0, 2, 1, 3)).reshape(3 * frames, 4 * count)
    return (left @ basis).reshape(frames, 3, len(vertices)).transpose(0, 2, 1)


def skin_basis(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The right factor of `skin`: weights times homogeneous rest positions, shape (4K, V), float32."""
    basis = np.empty((weights.shape[1], 4, len(vertices)), np.float32)
    columns = np.ascontiguousarray(weights.T, dtype=np.float32)
    for axis in range(3):
        np.multiply(columns, vertices[:, axis].astype(np.float32), out=basis[:, axis])
    basis[:, 3] = columns
    return basis.reshape(-1, len(vertices))


def skin_reference(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """`skin` as its definition reads, one frame and one handle at a time, in double precision."""
    out = np.zeros((len(transforms), len(vertices), 3))
    for frame, handles in enumerate(np.asarray(transforms, float)):
        for handle, transform in enumerate(handles):
            moved = vertices @ transform[:, :3].T + transform[:, 3]
            out[frame] += weights[:, handle, None] * moved
    return out
