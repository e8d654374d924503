"""Surface areas of triangle meshes."""

from __future__ import annotations

import numpy as np

__all__ = ["vertex_areas"]


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Surface area that each vertex stands for: a third of each of its triangles [m^2], shape (V,), float64."""
    corners = np.asarray(vertices, np.float64)[faces]
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.bincount(faces.ravel(), np.repeat(double / 6, 3), minlength=len(vertices))
