"""The clean graph of any mesh: welded, in canonical order, with its loose parts joined.

Files bring seams, STL soup, duplicate and degenerate faces, stray vertices and dozens of loose parts. `clean_mesh`
gives the surface that they mean, in an order that depends on the shape alone: not on the order of vertices and faces in
the file, nor on open or closed seams. Scale and offset cancel, up to rounding.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bunraku.errors import CharacterError

# points nearer than this share of the largest extent (some roundings of float32) are always welded, points four times
# as far apart never directly
_WELD = 2.5e-6
_DIRECTION = (0.8017837257372732, 0.5129891760425771, 0.3068528194400547)  # no plane of a usual model is square to it


@dataclass(frozen=True, eq=False)
class CleanMesh:
    """The welded surface of a mesh, normalised and in canonical order."""

    vertices: np.ndarray  # positions, the bounding box centred on 0 and the largest extent 1, shape (C, 3), float64
    faces: np.ndarray  # vertex indices, shape (F, 3), int64; three different vertices each, no face twice
    index: np.ndarray  # clean vertex of each original vertex, the nearest one for those without faces, shape (V,)
    used: np.ndarray  # original vertices that have faces, shape (V,), bool
    center: np.ndarray  # centre of the original bounding box [m], shape (3,)
    scale: float  # largest extent of the original [m]: original = vertices * scale + center


_kept: OrderedDict[bytes, CleanMesh] = OrderedDict()
KEPT = 2
"""Meshes that are kept clean: a character's, and that of its body alone."""


def clean_mesh(vertices: np.ndarray, faces: np.ndarray) -> CleanMesh:
    """Weld, clean, normalise and sort a mesh of vertices [m] (V, 3) and faces (F, 3). The last ones are kept, since all
    that looks at a character begins here; their arrays cannot be written on.

    Vertices closer than 2.5e-6 of the largest extent become one. Faces with fewer than three different vertices and
    repeated faces are dropped; of a face in both orientations the commoner one stays, or the one that looks outward.
    Slivers stay, since they hold neighbours together. CharacterError if a coordinate is not finite, a face names no
    vertex, or no face has an area to speak of.
    """
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    parts = (repr((vertices.shape, faces.shape)).encode(), vertices.tobytes(), faces.tobytes())
    key = hashlib.blake2b(b"".join(parts)).digest()
    clean = _kept.pop(key, None) or _cleaned(vertices, faces)
    _kept[key] = clean
    while len(_kept) > KEPT:
        _kept.popitem(last=False)
    return clean


def _cleaned(vertices: np.ndarray, faces: np.ndarray) -> CleanMesh:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise CharacterError(f"a mesh needs vertices (V, 3) and faces (F, 3), not {vertices.shape} and {faces.shape}")
    if len(faces) == 0 or len(vertices) == 0:
        raise CharacterError("the mesh has no faces; make a surface of it first")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise CharacterError("a face uses a vertex that does not exist; the mesh is broken")
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    if not np.isfinite(vertices.sum()) and not np.isfinite(vertices[used]).all():
        raise CharacterError("the mesh has coordinates that are not numbers; clean it and export it again")
    kept = np.flatnonzero(used)
    points = vertices[kept]
    low, high = points.min(axis=0), points.max(axis=0)
    center, scale = low + (high - low) / 2, float((high - low).max())
    if not 0 < scale < np.inf:
        raise CharacterError("all faces are at one point; there is nothing to animate")
    points = (points - center) / scale

    welded, label = _weld(points)
    index = np.zeros(len(vertices), np.int64)
    index[kept] = label
    faces = distinct_faces(welded, index[faces])
    if len(faces) == 0:
        raise CharacterError("every face is degenerate; there is no surface to animate")
    alive = np.zeros(len(welded), bool)
    alive[faces] = True
    if not alive.all():
        used[kept] = alive[label]
        number = np.cumsum(alive) - 1
        welded, faces, index = welded[alive], number[faces], number[index]
    if not used.all():
        stray = np.flatnonzero(~used)
        where = np.nan_to_num((vertices[stray] - center) / scale, nan=0.0, posinf=1e9, neginf=-1e9)
        index[stray] = cKDTree(welded).query(where)[1]
    for array in (welded, faces, index, used):
        array.flags.writeable = False
    return CleanMesh(welded, faces, index, used, center, scale)


def canonical_order(points: np.ndarray) -> np.ndarray:
    """An order of points that depends on their positions alone, shape (C,): along one fixed direction that no usual
    model is aligned with, so that neighbours keep their order under rounding; equal ones by x, y and z.
    """
    index = along(points)
    order = np.argsort(index, kind="stable")
    tied = np.flatnonzero(index[order[1:]] == index[order[:-1]])
    if len(tied) and (points[order[tied]] != points[order[tied + 1]]).any():
        order = np.lexsort((points[:, 2], points[:, 1], points[:, 0], index))
    return order


def along(vectors: np.ndarray) -> np.ndarray:
    """Component of each vector along the fixed direction that breaks ties, shape (C, 3) -> (C,)."""
    x, y, z = vectors.T
    # Not a BLAS product, whose rounding depends on the row.
    return np.asarray(x * _DIRECTION[0] + y * _DIRECTION[1] + z * _DIRECTION[2])


def canonical_rank(points: np.ndarray) -> np.ndarray:
    """Position of each point in the canonical order, shape (C,)."""
    rank = np.empty(len(points), np.int64)
    rank[canonical_order(points)] = np.arange(len(points))
    return rank


def pack(columns: np.ndarray, count: int) -> np.ndarray:
    """A key for each row of whole numbers below `count`, in their lexicographic order, shape (R, C) -> (R,)."""
    if count ** columns.shape[1] < 2**63:
        key = columns[:, 0].astype(np.int64)
        for column in range(1, columns.shape[1]):
            key = key * count + columns[:, column]
        return key
    return np.unique(columns, axis=0, return_inverse=True)[1].reshape(-1)


def _weld(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Welded points in canonical order (C, 3), and the welded point of each given one."""
    order = canonical_order(points)
    points = points[order]
    # Cells of four grids, a quarter of a cell apart along every axis. A border that parts two near points does so in
    # one grid for each axis, so the fourth grid joins them.
    grids = [np.floor(points / (4 * _WELD) + shift) for shift in (0.5, 0.75, 0.0, 0.25)]
    firsts = [_first_alike(pack((cells + 60000).astype(np.int64), 120001)) for cells in grids]
    here = np.arange(len(points))
    rows, columns = np.tile(here, 4), np.concatenate(firsts)
    moved = rows != columns
    label = first = here
    if moved.any():
        graph = coo_matrix((np.ones(moved.sum(), bool), (rows[moved], columns[moved])), shape=(len(points),) * 2)
        part = connected_components(graph, directed=False)[1]
        _, first, label = np.unique(part, return_index=True, return_inverse=True)
        rank = np.empty(len(first), np.int64)
        rank[np.argsort(first)] = np.arange(len(first))
        label, first = rank[label], np.sort(first)
    back = np.empty(len(points), np.int64)
    back[order] = label
    return points[first], back


def _first_alike(key: np.ndarray) -> np.ndarray:
    """The first index at which each key occurs, shape (N,)."""
    ordered = np.sort(key)
    out = np.arange(len(key))
    again = ordered[1:][ordered[1:] == ordered[:-1]]  # sorting numbers alone is ten times as fast as np.unique
    if len(again):
        repeated = np.flatnonzero(np.isin(key, again))
        _, first, inverse = np.unique(key[repeated], return_index=True, return_inverse=True)
        out[repeated] = repeated[first[inverse]]
    return out


def distinct_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces of three different vertices, each once, smallest vertex first, sorted, shape (F, 3) -> (G, 3). Of a face in
    both orientations the commoner one stays; if they are even, the one that looks away from 0.
    """
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) == 0:
        return faces
    a, b, c = faces.T
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    middle = a + b + c - low - high
    flipped = ~(((a == low) & (b == middle)) | ((b == low) & (c == middle)) | ((c == low) & (a == middle)))
    key = pack(np.stack([low, middle, high], 1), len(vertices))
    first = np.argsort(key)
    ordered = key[first]
    if (ordered[1:] != ordered[:-1]).all():  # as of a clean file: no face is there twice
        low, middle, high, turned = low[first], middle[first], high[first], flipped[first]
        return np.stack([low, np.where(turned, high, middle), np.where(turned, middle, high)], axis=1)
    key, first, inverse, repeats = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    low, middle, high = low[first], middle[first], high[first]
    turns = np.bincount(inverse, flipped, len(key))
    turned = turns > 0.5 * repeats
    both = 2 * turns == repeats
    p, q, r = vertices[low[both]], vertices[middle[both]], vertices[high[both]]
    turned[both] = (np.cross(q - p, r - p) * (p + q + r)).sum(axis=1) < 0
    return np.stack([low, np.where(turned, high, middle), np.where(turned, middle, high)], axis=1)


def unique_edges(faces: np.ndarray, count: int) -> np.ndarray:
    """Each undirected edge of the faces once, smaller vertex first, sorted, shape (E, 2), int64."""
    a, b = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    low, high = np.minimum(a, b), np.maximum(a, b)
    return unpack_pairs(low[low != high] * count + high[low != high], count)


def unpack_pairs(key: np.ndarray, count: int) -> np.ndarray:
    """Each pair (a, b) of the keys `a * count + b` once, sorted, shape (E, 2), int64."""
    if max(int(key.max(initial=0)), count) < 2**31:
        key = key.astype(np.int32)  # sorted in half the time
    key = np.sort(key)  # several times as fast as the hashing of np.unique
    fresh = np.ones(len(key), bool)
    fresh[1:] = key[1:] != key[:-1]
    out = np.empty((np.count_nonzero(fresh), 2), np.int64)
    out[:, 0], out[:, 1] = np.divmod(key[fresh], key.dtype.type(count))
    return out


def mesh_parts(edges: np.ndarray, count: int) -> np.ndarray:
    """Number of the loose part of each vertex, shape (V,), int64, in the order of their first vertices."""
    first, second = edges.T
    if not (first[1:] >= first[:-1]).all():
        order = np.argsort(first, kind="stable")
        first, second = first[order], second[order]
    starts = np.zeros(count + 1, np.int32)
    np.cumsum(np.bincount(first, minlength=count), out=starts[1:])
    graph = csr_matrix((np.ones(len(edges)), second.astype(np.int32), starts), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def mean_operator(edges: np.ndarray, count: int, own: bool = False) -> csr_matrix:
    """The matrix that averages values over a vertex's neighbours, by undirected edges, each once (E, 2): shape (V, V),
    float32, rows sum to 1. With `own` a vertex counts among its neighbours; one without neighbours always does.
    """
    degree = np.bincount(edges.reshape(-1), minlength=count)
    selves = np.arange(count) if own else np.flatnonzero(degree == 0)
    rows = np.concatenate([edges[:, 0], edges[:, 1], selves])
    columns = np.concatenate([edges[:, 1], edges[:, 0], selves])
    total = np.bincount(rows, minlength=count)
    return csr_matrix(((1 / total[rows]).astype(np.float32), (rows, columns)), shape=(count, count))


def bridge_edges(vertices: np.ndarray, parts: np.ndarray, per_part: int = 3) -> np.ndarray:
    """Edges, `per_part` between two, that join loose parts to their nearest neighbours until the graph is connected,
    smaller vertex first, sorted, shape (B, 2), int64. In each round every part but the largest is joined to the part
    nearest to it, between their nearest vertices; joined parts count as one in the next round (Boruvka). Vertices have
    shape (V, 3), and the part of each (V,).
    """
    parts = np.unique(parts, return_inverse=True)[1]
    bridges = np.zeros((0, 2), np.int64)
    if parts.max(initial=0) == 0:
        return bridges
    tree = cKDTree(vertices)
    near = min(12, len(vertices))
    distances, others = tree.query(vertices, near)
    starts = np.repeat(np.arange(len(vertices)), near)
    local = np.stack([starts, others.reshape(-1)], axis=1)
    local_distance = distances.reshape(-1)
    while (count := int(parts.max()) + 1) > 1:
        apart = parts[local[:, 0]] != parts[local[:, 1]]
        pairs, lengths = [local[apart]], [local_distance[apart]]
        sizes = np.bincount(parts)
        lonely = np.ones(count, bool)
        lonely[parts[local[apart, 0]]] = False
        lonely[sizes.argmax()] = False
        for part in np.flatnonzero(lonely):
            inside, outside = np.flatnonzero(parts == part), np.flatnonzero(parts != part)
            if len(inside) > len(outside):
                far, which = cKDTree(vertices[inside]).query(vertices[outside])
                pair = np.stack([inside[which], outside], axis=1)
            else:
                far, which = cKDTree(vertices[outside]).query(vertices[inside])
                pair = np.stack([inside, outside[which]], axis=1)
            pairs.append(pair)
            lengths.append(far)
        pair, length = np.concatenate(pairs), np.concatenate(lengths)
        # The second term decides between mirror images, which rounding would do otherwise.
        length = length + 1e-3 * along(vertices[pair[:, 1]] + 0.7 * vertices[pair[:, 0]])
        order = np.lexsort((pair[:, 1], pair[:, 0], length))
        pair = pair[order]
        first, second = parts[pair[:, 0]], parts[pair[:, 1]]
        target = np.full(count, -1)
        target[first[::-1]] = second[::-1]  # the shortest is written last
        target[sizes.argmax()] = -1
        pair, first = pair[target[first] == second], first[target[first] == second]
        by_part = np.argsort(first, kind="stable")
        pair, first = pair[by_part], first[by_part]
        rank = np.arange(len(first)) - np.searchsorted(first, first)
        bridges = np.concatenate([bridges, np.sort(pair[rank < per_part], axis=1)])
        joined = np.flatnonzero(target >= 0)
        parts = mesh_parts(np.stack([joined, target[joined]], axis=1), count)[parts]
    return unpack_pairs(bridges[:, 0] * len(vertices) + bridges[:, 1], len(vertices))
