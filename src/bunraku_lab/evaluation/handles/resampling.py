"""The same surface with another number of vertices, and values carried from one mesh of it to another."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku.geometry.graph import clean_mesh
from bunraku.geometry.subdivision import split_estimate, split_long_edges

__all__ = ["carried", "resampled"]


def resampled(character: Character, count: int) -> Character:
    """A character with about `count` vertices: welded, then simplified by edge collapses or refined by halving long
    edges.

    Args:
        character: Any mesh.
        count: Vertices that the result should have. Loose parts may leave it with more.
    """
    clean = clean_mesh(character.vertices, character.faces)
    vertices, faces = clean.vertices, clean.faces
    if len(vertices) > count:
        vertices, faces = _fewer(vertices, faces, count)
    if len(vertices) < 0.9 * count:
        vertices, faces = _more(vertices, faces, count)
    return Character(character.name, vertices * clean.scale + clean.center, faces)


def _fewer(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    import fast_simplification

    target = int(len(faces) * count / len(vertices))
    points, triangles = vertices.astype(np.float32), faces.astype(np.int32)
    for _ in range(3):
        points, triangles = fast_simplification.simplify(points, triangles, target_count=max(target, 4))
        used = np.unique(triangles)
        if len(used) <= 1.05 * count:
            break
        target = int(target * count / len(used))
    back = np.zeros(len(points), np.int64)
    back[used] = np.arange(len(used))
    return points[used].astype(np.float64), back[triangles]


def _more(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    def grown(length: float) -> float:
        return len(vertices) + split_estimate(vertices, faces, length) / 2

    low, high = 1e-4, 2.0  # of the largest extent: a length that makes too many, one that makes too few
    points, triangles = vertices, faces
    for _ in range(4):  # the estimate is off by a constant factor, which the second bisection takes out
        factor = len(points) / grown(high) if len(points) > len(vertices) else 1.0
        least, most = low, 2.0
        for _ in range(40):
            middle = float(np.sqrt(least * most))
            least, most = (middle, most) if factor * grown(middle) > count else (least, middle)
        high = most
        points, triangles, _ = split_long_edges(vertices, faces, high, max_faces=4 * count)
        if 0.95 * count <= len(points) <= 1.1 * count:
            break
    return points, triangles


def carried(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values of a mesh's vertices at the points of its surface that are closest to given ones.

    Args:
        values: Shape (V, C).
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        points: Positions near the surface [m], shape (P, 3).

    Returns:
        Barycentric means, shape (P, C), float64.
    """
    import igl

    vertices = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int64)
    _, face, nearest = igl.point_mesh_squared_distance(np.ascontiguousarray(points, np.float64), vertices, faces)
    face = np.asarray(face).reshape(-1)
    a, b, c = (vertices[faces[face, corner]] for corner in range(3))
    u, v, p = b - a, c - a, nearest - a
    uu, uv, vv, pu, pv = ((x * y).sum(axis=1) for x, y in ((u, u), (u, v), (v, v), (p, u), (p, v)))
    determinant = uu * vv - uv * uv
    flat = determinant <= 1e-12 * uu * vv
    s = np.where(flat, 0, (vv * pu - uv * pv) / np.where(flat, 1, determinant))
    t = np.where(flat, 0, (uu * pv - uv * pu) / np.where(flat, 1, determinant))
    shares = np.clip(np.stack([1 - s - t, s, t], axis=1), 0, 1)
    shares /= shares.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("pi,pic->pc", shares, np.asarray(values, np.float64)[faces[face]]))
