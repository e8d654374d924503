"""Surfaces of triangle meshes: normals that no degenerate face can spoil, areas, and points spread over them."""

from __future__ import annotations

import numpy as np

__all__ = ["face_normals", "surface_points", "vertex_areas", "vertex_normals"]


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of faces with the length of twice their area [m^2], shape (F, 3), float64."""
    vertices = np.asarray(vertices, np.float64)
    origin = vertices[faces[:, 0]]
    u, v = vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin
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


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Surface area that each vertex stands for: a third of each of its triangles [m^2], shape (V,), float64."""
    double = _lengths(face_normals(vertices, faces))
    return np.bincount(faces.ravel(), np.repeat(double / 6, 3), minlength=len(vertices))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


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
    cross = face_normals(vertices, faces)
    area = _lengths(cross)
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
    origin = vertices[faces[face, 0]].astype(np.float64)
    first, second = vertices[faces[face, 1]] - origin, vertices[faces[face, 2]] - origin
    points = origin + along[:, None] * first + across[:, None] * second
    length = np.linalg.norm(cross[face], axis=1, keepdims=True)
    return points, cross[face] / np.where(length > 0, length, 1)
