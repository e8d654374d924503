"""Surfaces of triangle meshes: normals, areas, sampled points, subdivision, winding numbers and extreme vertices."""

from __future__ import annotations

from functools import lru_cache

import numpy as np


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of faces with the length of twice their area [m^2], shape (F, 3), float64."""
    vertices = np.asarray(vertices, np.float64)
    origin = vertices[faces[:, 0]]
    return _cross(vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray, unit: bool = True) -> np.ndarray:
    """Area-weighted normals of the vertices [m] (V, 3) of faces (F, 3), shape (V, 3), float64: of length 1 if `unit`,
    else the sum of the face normals, each as long as a third of its area [m^2]. A vertex without area gets +Y if
    `unit`, else zero.
    """
    normals = face_normals(vertices, faces) / 6
    corners = faces.reshape(-1)
    out = np.stack([np.bincount(corners, np.repeat(normals[:, axis], 3), len(vertices)) for axis in range(3)], axis=1)
    if not unit:
        return out
    # Work relative to the largest component: areas of small meshes square to less than the smallest double.
    largest = np.abs(out).max(axis=1, keepdims=True)
    scale = largest.max(initial=0)
    fine = largest > 1e-12 * scale
    out = np.where(fine, out / np.where(fine, largest, 1), [0.0, 1.0, 0.0])
    unit_normals: np.ndarray = out / np.sqrt(np.square(out).sum(axis=1, keepdims=True))
    return unit_normals


def unit_normals(normals: np.ndarray) -> np.ndarray:
    """Normals of length 1, shape (V, 3), float64; +Y where they have no direction."""
    normals = np.nan_to_num(normals.astype(np.float64), posinf=0, neginf=0)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 1, 0])


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Surface area that each vertex stands for: a third of each of its triangles [m^2], shape (V,), float64."""
    double = _lengths(face_normals(vertices, faces))
    return np.bincount(faces.ravel(), np.repeat(double / 6, 3), minlength=len(vertices))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


# The plastic number's powers: two numbers that fill a square evenly (Roberts 2018).
_STEPS = 0.7548776662466927, 0.5698402909980532


def surface_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` points at equal distances in area along the list of faces (F, 3) of vertices (V, 3), and the unit normals
    of their faces, both (N, 3), float64; a normal is 0 where a face has no area.

    Rotating the mesh rotates the points; they do not depend on its position or size. A mesh without area gives its
    corners.
    """
    cross = face_normals(vertices, faces)
    area = _lengths(cross)
    total = float(area.sum())
    if not np.isfinite(total) or total <= 0:
        area, total = np.ones(len(faces)), float(len(faces))
    ends = np.cumsum(area)
    face = np.searchsorted(ends, (np.arange(count) + 0.5) * (ends[-1] / count), side="right")
    face = np.minimum(face, len(faces) - 1)
    number = np.arange(1, count + 1)
    along, across = (number * _STEPS[0]) % 1, (number * _STEPS[1]) % 1
    folded = along + across > 1
    along, across = np.where(folded, 1 - along, along), np.where(folded, 1 - across, across)
    origin = vertices[faces[face, 0]].astype(np.float64)
    first, second = vertices[faces[face, 1]] - origin, vertices[faces[face, 2]] - origin
    points = origin + along[:, None] * first + across[:, None] * second
    length = np.linalg.norm(cross[face], axis=1, keepdims=True)
    return points, cross[face] / np.where(length > 0, length, 1)


def split_estimate(vertices: np.ndarray, faces: np.ndarray, length: float) -> float:
    """About how many faces `split_long_edges` would add."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    cross = np.square(u).sum(1) * np.square(v).sum(1) - np.square((u * v).sum(1))
    area = 0.5 * np.sqrt(np.maximum(cross, 0))
    around = np.sqrt(np.square(u).sum(1)) + np.sqrt(np.square(v).sum(1)) + np.sqrt(np.square(c - b).sum(1))
    return float(np.where(around > 2 * length, 3 * area / length**2 + around / length, 0).sum())


def split_long_edges(
    vertices: np.ndarray, faces: np.ndarray, length: float, max_faces: int = 400_000
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Halve the edges longer than `length` of faces (F, 3) of vertices (V, 3) until there are none, or until that would
    add more than `max_faces`. All faces at an edge split it at its middle, so the mesh stays as connected as it was.

    Returns:
        Vertices (V + P, 3), the old ones first; faces; and for each round the pairs (P_r, 2) whose middles it appended.
    """
    rounds: list[np.ndarray] = []
    limit = len(faces) + max_faces
    done = np.zeros((0, 3), np.int64)
    active = faces
    while len(active):
        corners = vertices[active]
        sides = np.sqrt(np.square(corners - corners[:, [1, 2, 0]]).sum(axis=2))
        long = sides > length  # sides ab, bc, ca
        any_long = long.any(axis=1)
        done = np.concatenate([done, active[~any_long]])
        active, long = active[any_long], long[any_long]
        if len(active) == 0:
            break
        if len(done) + len(active) + int(long.sum()) > limit:
            break
        a, b = active, active[:, [1, 2, 0]]
        low, high = np.minimum(a, b), np.maximum(a, b)
        key = (low * len(vertices) + high)[long]
        unique, inverse = np.unique(key, return_inverse=True)
        pairs = np.stack([unique // len(vertices), unique % len(vertices)], axis=1)
        middles = np.full(active.shape, -1)
        middles[long] = len(vertices) + inverse
        vertices = np.concatenate([vertices, 0.5 * (vertices[pairs[:, 0]] + vertices[pairs[:, 1]])])
        rounds.append(pairs)
        active = _split(vertices, active, middles)
    return vertices, np.concatenate([done, active]), rounds


def _split(vertices: np.ndarray, faces: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Faces cut at the middles of their sides ab, bc and ca, -1 where a side is not split."""
    marked = middles >= 0
    count = marked.sum(axis=1)
    out = []
    three = count == 3
    a, b, c = faces[three].T
    p, q, r = middles[three].T
    out += [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
    # One side: turn the face so that it is ab. Two: so that ca is the whole one.
    start = np.where(count == 1, marked.argmax(axis=1), ((~marked).argmax(axis=1) + 1) % 3)
    turn = (start[:, None] + np.arange(3)) % 3
    faces, middles = np.take_along_axis(faces, turn, axis=1), np.take_along_axis(middles, turn, axis=1)
    a, b, c = faces[count == 1].T
    p = middles[count == 1, 0]
    out += [(a, p, c), (p, b, c)]
    a, b, c = faces[count == 2].T
    p, q = middles[count == 2, 0], middles[count == 2, 1]
    out.append((p, b, q))
    pc, aq = (_lengths(vertices[start] - vertices[end]) for start, end in ((p, c), (a, q)))
    first = pc <= aq * (1 + 1e-3)  # ties must not hang on rounding
    out += [(p[first], q[first], c[first]), (a[first], p[first], c[first])]
    other = ~first
    out += [(a[other], p[other], q[other]), (a[other], q[other], c[other])]
    return np.concatenate([np.stack(triangle, axis=1) for triangle in out])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """As `np.cross`, which takes longer for a few hundred, shape (F, 3)."""
    out = np.empty_like(a)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[:, axis] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out


_GOLDEN = np.pi * (3 - np.sqrt(5))


@lru_cache(maxsize=8)
def _directions(count: int) -> np.ndarray:
    """Directions spread evenly over the sphere, shape (count, 3), float32."""
    number = np.arange(count)
    height = 1 - (2 * number + 1) / count
    radius = np.sqrt(1 - height**2)
    directions = np.stack([radius * np.cos(_GOLDEN * number), height, radius * np.sin(_GOLDEN * number)], axis=1)
    return directions.astype(np.float32)


def extreme_points(points: np.ndarray, count: int = 64) -> np.ndarray:
    """Indices, in order, of the points (n, 3), n > 0, that reach farthest in each of `count` directions spread over the
    sphere. A point farther out in some direction than all of these is so by at most about a share 2 / count of its
    distance.
    """
    return np.unique((_directions(count) @ (points - points.mean(axis=0)).astype(np.float32).T).argmax(axis=1))


def part_extremes(vertices: np.ndarray, weights: np.ndarray, count: int = 160) -> np.ndarray:
    """Indices, in order, of the extreme points, in `count` directions, of every part of a body of vertices at rest (V,
    3), shape (n,).

    Parts are the vertices that one handle moves more than the others do, by weights (V, K), and where a second one has
    a fair share, as at knees and elbows, those that the two move.
    """
    if len(vertices) == 0:
        return np.zeros(0, np.int64)
    most = weights.argmax(axis=1)
    shared = weights[np.arange(len(weights)), most] < 0.75
    label = most + weights.shape[1] * shared
    out = []
    for part in np.unique(label):
        members = np.flatnonzero(label == part)
        out.append(members if len(members) <= count else members[extreme_points(vertices[members], count)])
    return np.sort(np.concatenate(out))
