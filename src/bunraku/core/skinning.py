"""Linear blend skinning of all frames as one matrix product, with the readable reference beside it."""

from __future__ import annotations

import numpy as np

__all__ = ["skin", "skin_reference"]


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Blend-skin every vertex in every frame as one GEMM, (3N, 4K) @ (4K, V).

    Args:
        vertices: Rest positions [m], shape (V, 3).
        weights: Skinning weights, shape (V, K).
        transforms: Affine transform of each handle, shape (N, K, 3, 4).

    Returns:
        Posed positions [m], shape (N, V, 3), float32: a view with coordinates apart, `result[n]` is cheap to make contiguous.
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
