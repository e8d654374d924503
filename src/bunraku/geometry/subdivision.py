"""Splitting long edges, conforming across shared edges and bounded in number."""

from __future__ import annotations

import numpy as np

__all__ = ["split_estimate", "split_long_edges"]


def _lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of vertex pairs [m], shape (E,)."""
    difference = vertices[edges[:, 0]] - vertices[edges[:, 1]]
    lengths: np.ndarray = np.sqrt(np.square(difference).sum(axis=1))
    return lengths


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
    """Halve the edges longer than `length` until there are none.

    All faces at an edge split it at its middle, so the mesh stays as connected as it was. It stops early rather than
    make more than `max_faces` faces.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        length: Longest edge to leave.
        max_faces: Bound on the number of new faces.

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
    """Faces cut at the middles of their sides ab, bc and ca, -1 where a side stays whole."""
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
    first = _lengths(vertices, np.stack([p, c], 1)) <= _lengths(vertices, np.stack([a, q], 1)) * (
        1 + 1e-3
    )  # ties must not hang on rounding
    out += [(p[first], q[first], c[first]), (a[first], p[first], c[first])]
    other = ~first
    out += [(a[other], p[other], q[other]), (a[other], q[other], c[other])]
    return np.concatenate([np.stack(triangle, axis=1) for triangle in out])
