"""How often a surface, which may have holes, winds around points: about 1 inside, 0 outside.

The generalised winding number (Jacobson et al. 2013) sums the solid angles of all faces, here those of near faces one
by one and those of far ones as dipoles of whole clusters (Barill et al. 2018).
"""

from __future__ import annotations

import numpy as np

__all__ = ["winding_numbers"]

FAR = 2.0
"""Radii of a cluster from its middle beyond which it is a dipole."""
_FACES, _POINTS = 24, 256
"""Faces of a cluster, and points that are looked at together, at most."""


def winding_numbers(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The winding number of a surface about each point; positive where faces look away from it. To some 0.02.

    Args:
        points: Shape (P, 3).
        vertices: Of the surface, shape (V, 3).
        faces: Shape (F, 3).

    Returns:
        Shape (P,), float64.
    """
    points, vertices = np.asarray(points, np.float64), np.asarray(vertices, np.float64)
    corners = vertices[faces]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size, middles = np.linalg.norm(areas, axis=1) + 1e-30, corners.mean(axis=1)
    clusters = _clusters(middles, _FACES)
    order, starts = np.concatenate(clusters), np.cumsum([0, *map(len, clusters)])[:-1]
    sums = np.add.reduceat(np.hstack([areas, size[:, None] * middles, size[:, None]])[order], starts)
    centers = sums[:, 3:6] / sums[:, 6:]
    cluster = np.repeat(np.arange(len(clusters)), [len(own) for own in clusters])
    away = np.linalg.norm(corners[order] - centers[cluster, None], axis=2).max(axis=1)
    reach = np.maximum.reduceat(away, starts)
    unit = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / 10
    dipoles = (sums[:, :3] / unit**2).astype(np.float32)
    out, number = np.empty(len(points)), np.zeros(len(vertices), np.int64)
    for some in _clusters(points, _POINTS):
        own = points[some]
        middle = (own.min(axis=0) + own.max(axis=0)) / 2
        wide = np.linalg.norm(own - middle, axis=1).max()
        far = np.linalg.norm(centers - middle, axis=1) - wide > FAR * reach
        # Over their size about their middle, so that single precision does.
        own = ((own - middle) / unit).astype(np.float32)
        found = _of_dipoles(own, ((centers[far] - middle) / unit).astype(np.float32), dipoles[far])
        near = [clusters[one] for one in np.flatnonzero(~far)]
        if near:
            corner = faces[np.concatenate(near)]
            here = np.zeros(len(vertices), bool)  # np.unique sorts, which takes longer
            here[corner] = True
            used = np.flatnonzero(here)
            number[used] = np.arange(len(used))
            found += _of_faces(own, ((vertices[used] - middle) / unit).astype(np.float32), number[corner])
        out[some] = found / (4 * np.pi)
    return out


def _clusters(points: np.ndarray, most: int) -> list[np.ndarray]:
    """Indices of points that lie near one another, in groups of so many at most: halved along their longest side."""
    left, out = [np.arange(len(points))] if len(points) else [], []
    while left:
        own = left.pop()
        if len(own) <= most:
            out.append(own)
            continue
        some = points[own]
        along = some[:, np.ptp(some, axis=0).argmax()]
        order = np.argpartition(along, len(own) // 2)
        left += [own[order[: len(own) // 2]], own[order[len(own) // 2 :]]]
    return out


def _of_dipoles(points: np.ndarray, centers: np.ndarray, dipoles: np.ndarray) -> np.ndarray:
    """Sum of the solid angles of clusters as seen from afar, shape (P,), float64."""
    square = (points**2).sum(axis=1)[:, None] - 2 * points @ centers.T + (centers**2).sum(axis=1)
    towards = (centers * dipoles).sum(axis=1) - points @ dipoles.T
    return np.asarray((towards / (square * np.sqrt(square))).sum(axis=1, dtype=np.float64))


def _of_faces(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sum of the solid angles of triangles (Van Oosterom & Strackee 1983), shapes (P, 3), (V, 3), (F, 3) -> (P,).

    Of corners a, b, c seen from a point: tan(angle / 2) = a . (b x c) / (|a||b||c| + (a . b)|c| + (b . c)|a| + (c .
    a)|b|), in which all but the lengths is linear in the point and its square.
    """
    a, b, c = vertices[faces].transpose(1, 0, 2)
    one, none = np.ones((len(faces), 1), np.float32), np.zeros((len(faces), 1), np.float32)
    bc = _cross(b, c)
    across = _cross(a, b) + bc + _cross(c, a)
    top = np.hstack([-across, none, (a * bc).sum(axis=1, keepdims=True)])
    pairs = [np.hstack([-x - y, one, (x * y).sum(axis=1, keepdims=True)]) for x, y in ((a, b), (b, c), (c, a))]
    known = np.vstack([points.T, (points**2).sum(axis=1), np.ones(len(points), np.float32)])
    volume, ab, bc, ca = (np.vstack([top, *pairs]) @ known).reshape(4, len(faces), len(points))
    corner = np.hstack([-2 * vertices, np.ones((len(vertices), 1), np.float32), (vertices**2).sum(axis=1)[:, None]])
    lengths = np.sqrt(np.maximum(corner @ known, 0))
    to_a, to_b, to_c = (lengths[faces[:, side]] for side in range(3))
    ab += to_a * to_b
    ab *= to_c
    bc *= to_a
    ca *= to_b
    ab += bc
    ab += ca
    return np.asarray(2 * np.arctan2(volume, ab).sum(axis=0, dtype=np.float64))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """As `np.cross`, which takes longer for a few hundred, shape (F, 3)."""
    out = np.empty_like(a)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[:, axis] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out
