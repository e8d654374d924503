"""Nearest points on a mesh near a known position, as one sparse matrix of smooth barycentric weights; and distances of
points from points and from surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree

_CHUNK = 60_000  # point-triangle pairs at a time: small enough for the cache
_MOST_TRIANGLES = 64  # around one vertex
_FIRST = 64  # points that are asked first for the distance beyond which the others need not be looked for


def least_distance(tree: cKDTree, points: np.ndarray) -> float:
    """Least distance of some points, shape (P, 3), to those of a tree. A few points bound it, so that far parts cost
    next to nothing.
    """
    bound = float(tree.query(points[:: max(1, len(points) // _FIRST)])[0].min())
    return min(bound, float(tree.query(points, distance_upper_bound=bound * (1 + 1e-9) + 1e-12)[0].min()))


@dataclass(frozen=True, eq=False)
class Stars:
    """Triangles by vertex, with what the nearest point on each needs."""

    triangles: np.ndarray
    pointer: np.ndarray
    members: np.ndarray
    first: np.ndarray
    u: np.ndarray
    v: np.ndarray
    dots: np.ndarray  # (3, T): u.u, u.v, v.v


def stars_of(vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray) -> Stars:
    """Triangles at each of the vertices (M, 3), from faces (F, 3) and edges (E, 2), smaller vertex first. Edges without
    faces and lone vertices count as triangles without width.
    """
    count = len(vertices)
    a, b = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    held = np.isin(edges[:, 0] * count + edges[:, 1], np.minimum(a, b) * count + np.maximum(a, b))
    bare = edges[~held]
    alone = np.ones(count, bool)
    alone[faces], alone[bare] = False, False
    single = np.flatnonzero(alone)
    triangles = np.concatenate([faces, bare[:, [0, 1, 1]], np.stack([single] * 3, axis=1)])
    owner = np.concatenate([faces.reshape(-1), bare.reshape(-1), single])
    number = np.repeat(np.arange(len(triangles)), np.repeat([3, 2, 1], [len(faces), len(bare), len(single)]))
    degree = np.bincount(owner, minlength=count)
    if degree.max() > _MOST_TRIANGLES:  # a hub, as no surface has it: its smallest triangles must do
        corners = vertices[triangles]
        size = np.square(corners - corners[:, [1, 2, 0]]).sum(axis=(1, 2))
        order = np.lexsort((size[number], owner))
        order = order[np.arange(len(order)) - np.repeat(np.cumsum(degree) - degree, degree) < _MOST_TRIANGLES]
        degree = np.minimum(degree, _MOST_TRIANGLES)
    else:
        order = np.argsort(owner, kind="stable")
    pointer = np.concatenate([[0], np.cumsum(degree)])
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    u, v = second - first, third - first
    dots = np.stack([(u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)])
    return Stars(triangles, pointer, number[order], first, u, v, dots)


@dataclass(frozen=True, eq=False)
class _Found:
    """Nearest points on the triangles around each point's home: a row per point and triangle, sorted by point."""

    owner: np.ndarray
    triangle: np.ndarray
    square: np.ndarray
    s: np.ndarray
    t: np.ndarray
    starts: np.ndarray
    nearest: np.ndarray

    def corners(self) -> np.ndarray:
        """Barycentric weights of the three corners, shape (R, 3)."""
        return np.stack([1 - self.s - self.t, self.s, self.t], axis=1)


def _search(points: np.ndarray, home: np.ndarray, stars: Stars) -> _Found:
    sizes = stars.pointer[home + 1] - stars.pointer[home]
    starts = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(home)), sizes)
    triangle = stars.members[np.arange(len(owner)) + (stars.pointer[home] - starts)[owner]]
    p = points[owner] - stars.first[triangle]
    pp, pu, pv = [(p * other).sum(axis=1) for other in (p, stars.u[triangle], stars.v[triangle])]
    square, s, t = _closest(pp, pu, pv, *stars.dots[:, triangle])
    return _Found(owner, triangle, square, s, t, starts, np.minimum.reduceat(square, starts))


def _walk(points: np.ndarray, home: np.ndarray, found: _Found, stars: Stars) -> np.ndarray:
    """Homes moved along the mesh for points whose nearest point is on the rim of their star; -1 for those that stay."""
    at_best = np.flatnonzero(found.square == found.nearest[found.owner])
    rows, first = np.unique(found.owner[at_best], return_index=True)
    best = at_best[first]
    corner, vertex = found.corners()[best], stars.triangles[found.triangle[best]]
    shares = (corner * (vertex == home[rows, None])).sum(axis=1)
    moved = np.full(len(home), -1)
    rim = np.flatnonzero((shares < 1e-6) & (found.nearest > 1e-14))
    new = vertex[rim, corner[rim].argmax(axis=1)]
    nearest = found.nearest[rim]
    for _ in range(3):
        if len(rim) == 0:
            break
        trial = _search(points[rim], new, stars)
        better = trial.nearest < nearest * (1 - 1e-9)
        moved[rim[better]] = new[better]
        at_best = np.flatnonzero(trial.square == trial.nearest[trial.owner])
        rows, first = np.unique(trial.owner[at_best], return_index=True)
        best = at_best[first]
        vertex = stars.triangles[trial.triangle[best]]
        new = vertex[np.arange(len(rim)), trial.corners()[best].argmax(axis=1)]
        rim, new, nearest = rim[better], new[better], trial.nearest[better]
    return moved


def blend_matrix(points: np.ndarray, home: np.ndarray, stars: Stars, width: float) -> csr_matrix:
    """Weights of mesh vertices at points (P, 3) whose position on the mesh is roughly known: near the vertices `home`
    (P,).

    Each point takes the nearest points of the triangles around its home vertex and their barycentric weights, blended
    by `exp(-(d^2 - d_min^2) / (2 width^2))`, so that weights change smoothly from triangle to triangle. Where the
    nearest point is on the rim of those triangles, the home first walks a few vertices towards it. Only neighbours on
    the mesh are looked at, so a finger takes nothing from the next finger, however near.

    Returns:
        Sparse weights, shape (P, M), float32, not negative, rows sum to 1.
    """
    order = np.argsort(home, kind="stable")  # neighbours share triangles, and these stay in the cache
    load = np.cumsum(np.diff(stars.pointer)[home[order]])
    cuts = np.searchsorted(load, np.arange(_CHUNK, load[-1], _CHUNK))
    blocks = []
    for rows in np.split(order, np.unique(cuts)):
        if len(rows) == 0:
            continue
        nearest = _search(points[rows], home[rows], stars)
        moved = _walk(points[rows], home[rows], nearest, stars)
        blocks.append(_blend(nearest, moved < 0, rows, stars, width))
        gone = np.flatnonzero(moved >= 0)
        if len(gone):
            nearest = _search(points[rows[gone]], moved[gone], stars)
            blocks.append(_blend(nearest, np.ones(len(gone), bool), rows[gone], stars, width))
    row, column, value = (np.concatenate([block[part] for block in blocks]) for part in range(3))
    return coo_matrix((value, (row, column)), shape=(len(points), len(stars.pointer) - 1)).tocsr()


def _blend(
    found: _Found, wanted: np.ndarray, rows: np.ndarray, stars: Stars, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of the blended weights of the wanted points."""
    share = np.exp((found.nearest[found.owner] - found.square) / (2 * width * width))
    keep = np.flatnonzero((share > 0.01) & wanted[found.owner])
    owner, share = found.owner[keep], share[keep]
    share = share / np.bincount(owner, share, len(rows))[owner]
    s, t = found.s[keep], found.t[keep]
    values = np.stack([share * (1 - s - t), share * s, share * t], axis=1).reshape(-1)
    columns = stars.triangles[found.triangle[keep]].reshape(-1)
    kept_values = np.flatnonzero(values > 1e-7)
    return np.repeat(rows[owner], 3)[kept_values], columns[kept_values], values[kept_values].astype(np.float32)


def _closest(
    pp: np.ndarray, pu: np.ndarray, pv: np.ndarray, uu: np.ndarray, uv: np.ndarray, vv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest points a + s u + t v of triangles to points a + p, from dot products alone: squared distance, s and t."""

    def along(top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
        return np.clip(top / np.maximum(bottom, 1e-30), 0, 1)

    # The three sides: a + s u, a + t v, and b + r (v - u).
    s_side, t_side = along(pu, uu), along(pv, vv)
    ww, pw = uu + vv - 2 * uv, pv - pu + uu - uv
    r_side = along(pw, ww)
    on_s = pp + s_side * (s_side * uu - 2 * pu)
    on_t = pp + t_side * (t_side * vv - 2 * pv)
    on_r = pp - 2 * pu + uu + r_side * (r_side * ww - 2 * pw)
    square, s, t = on_s, s_side, np.zeros_like(s_side)
    closer = on_t < square
    square, s, t = np.where(closer, on_t, square), np.where(closer, 0, s), np.where(closer, t_side, t)
    closer = on_r < square
    square, s, t = np.where(closer, on_r, square), np.where(closer, 1 - r_side, s), np.where(closer, r_side, t)
    determinant = uu * vv - uv * uv
    proper = determinant > 1e-9 * uu * vv
    divisor = np.where(proper, determinant, 1)
    s_in, t_in = (vv * pu - uv * pv) / divisor, (uu * pv - uv * pu) / divisor
    inside = proper & (s_in >= 0) & (t_in >= 0) & (s_in + t_in <= 1)
    square = np.where(inside, pp - s_in * pu - t_in * pv, square)
    return np.maximum(square, 0), np.where(inside, s_in, s), np.where(inside, t_in, t)
