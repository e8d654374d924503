"""Vertex normals that no degenerate face can spoil."""

from __future__ import annotations

import numpy as np

__all__ = ["face_normals", "vertex_normals"]


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of faces with the length of twice their area [m^2], shape (F, 3), float64."""
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    out = np.empty_like(u)  # np.cross takes three times as long
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[:, axis] = u[:, i] * v[:, j] - u[:, j] * v[:, i]
    return out


def vertex_normals(vertices: np.ndarray, faces: np.ndarray, unit: bool = True) -> np.ndarray:
    """Area-weighted normals of the vertices.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        unit: Scale to length 1; otherwise the sum of the face normals, each as long as a third of its area [m^2].

    Returns:
        Normals, shape (V, 3), float64. A vertex without area (no face, degenerate faces, faces that cancel) gets +Y
        when `unit`, else zero.
    """
    normals = face_normals(vertices, faces) / 6
    corners = faces.reshape(-1)
    out = np.stack([np.bincount(corners, np.repeat(normals[:, axis], 3), len(vertices)) for axis in range(3)], axis=1)
    if not unit:
        return out
    # Work relative to the largest component: areas of small meshes square to less than the smallest double.
    largest = np.abs(out).max(axis=1, keepdims=True)
    whole = largest.max(initial=0)
    fine = largest > 1e-12 * whole
    out = np.where(fine, out / np.where(fine, largest, 1), [0.0, 1.0, 0.0])
    unit_normals: np.ndarray = out / np.sqrt(np.square(out).sum(axis=1, keepdims=True))
    return unit_normals
