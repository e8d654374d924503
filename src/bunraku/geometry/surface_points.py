"""Points spread over a surface by area, always the same for the same mesh."""

from __future__ import annotations

import numpy as np

__all__ = ["surface_points"]

_STEPS = 0.7548776662466927, 0.5698402909980532  # the plastic number's powers: two numbers that fill a square evenly


def surface_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points at equal distances in area along the list of faces, with the normals of their faces.

    Turning the mesh turns the points; they do not depend on its place or size. A mesh without area gives its corners.

    Args:
        vertices: Positions, any unit, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        count: How many points, N.

    Returns:
        Points (N, 3) and unit normals (N, 3), float64; a normal is 0 where a face has no area.
    """
    origin = vertices[faces[:, 0]].astype(np.float64)
    first, second = vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin
    cross = np.cross(first, second)
    area = np.linalg.norm(cross, axis=1)
    total = float(area.sum())
    if not np.isfinite(total) or total <= 0:
        area, total = np.ones(len(faces)), float(len(faces))
    ends = np.cumsum(area)
    face = np.minimum(
        np.searchsorted(ends, (np.arange(count) + 0.5) * (ends[-1] / count), side="right"), len(faces) - 1
    )
    number = np.arange(1, count + 1)
    along, across = (number * _STEPS[0]) % 1, (number * _STEPS[1]) % 1
    folded = along + across > 1
    along, across = np.where(folded, 1 - along, along), np.where(folded, 1 - across, across)
    points = origin[face] + along[:, None] * first[face] + across[:, None] * second[face]
    length = np.linalg.norm(cross[face], axis=1, keepdims=True)
    return points, cross[face] / np.where(length > 0, length, 1)
