"""Skinning and rigid registration as their definitions read, for tests."""

import numpy as np


def skin_reference(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """`skin` as its definition reads, one frame and one handle at a time, in double precision."""
    out = np.zeros((len(transforms), len(vertices), 3))
    for frame, handles in enumerate(np.asarray(transforms, float)):
        for handle, transform in enumerate(handles):
            moved = vertices @ transform[:, :3].T + transform[:, 3]
            out[frame] += weights[:, handle, None] * moved
    return out


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
