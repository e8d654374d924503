"""The mesh that the networks see: about the same resolution for every character, whatever its file holds.

Long edges are split, then the vertices are merged by the cells of a fixed grid, where only vertices that are connected inside
a cell merge: fingers, legs and the two sides of a sheet stay apart, and every loose part keeps at least one vertex. Positions
and normals are area-weighted means over the merged surface. Unlike edge collapses, whose order decides their result, this
depends on the shape nearly alone: another tessellation, a rounded coordinate or an opened seam changes a mean a little and
never starts an avalanche.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack

from bunraku.errors import CharacterError
from bunraku.geometry.areas import vertex_areas
from bunraku.geometry.closest import blend_matrix
from bunraku.geometry.graph import (
    CleanMesh,
    along,
    bridge_edges,
    canonical_order,
    canonical_rank,
    clean_mesh,
    distinct_faces,
    mesh_parts,
    pack,
    unique_edges,
    unpack_pairs,
)
from bunraku.geometry.normals import vertex_normals
from bunraku.geometry.subdivision import split_estimate, split_long_edges

__all__ = ["NetworkMesh", "network_mesh"]

_CELLS_PER_AREA = 1.12  # network vertices over the area in cell faces: 1.5 cells crossed on average, less the crumbs
_MOST_SPLITS = 150_000
_CRUMB = 0.25  # area under which a patch joins its neighbour, in cell faces
_BORDER = 0.15  # half the width of the zone in which a vertex counts in two cells, in cells
_SMALLEST_CELL, _LARGEST_CELL = 1 / 2000, 0.08


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """A normalised mesh of network size, and the way between it and the vertices of the original.

    Args:
        vertices: Positions, the original's bounding box centred on 0 and its largest extent 1, shape (M, 3), float32.
        normals: Area-weighted mean normals of the surface that each vertex stands for, shape (M, 3), float32. Length 1 where
            that is flat; shorter where it bends; near 0 where it closes on itself, as a thin finger does.
        areas: Surface that each vertex stands for, shape (M,), float32; sums to the area of the normalised mesh.
        faces: Vertex indices, shape (F, 3), int64.
        edges: Undirected edges, bridges between loose parts included, each once, smaller vertex first, shape (E, 2), int64.
        components: Loose part of each vertex, shape (M,), int64.
        center: Centre of the original's bounding box [m], shape (3,), float64.
        scale: Its largest extent [m]: original = vertices * scale + center.
    """

    vertices: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    components: np.ndarray
    center: np.ndarray
    scale: float
    _index: np.ndarray = field(repr=False)
    _spread: csr_matrix = field(repr=False)
    _gather: tuple[csr_matrix, ...] = field(repr=False)

    def push(self, values: np.ndarray) -> np.ndarray:
        """Values of network vertices at every original vertex, shape (M, C) -> (V, C), float32.

        Barycentric at the nearest points of the network mesh around the vertex's own place in it, blended smoothly across
        edges. All weights are positive and sum to 1, so rows that sum to 1 stay so.
        """
        out: np.ndarray = self._spread @ np.asarray(values, np.float32)
        return out[self._index]

    def pull(self, values: np.ndarray) -> np.ndarray:
        """Values of original vertices as means over the surface of each network vertex, shape (V, C) -> (M, C), float32."""
        out = np.asarray(values, np.float64)
        for matrix in self._gather:
            out = matrix @ out
        return out.astype(np.float32)


def network_mesh(vertices: np.ndarray, faces: np.ndarray, max_vertices: int = 4000, max_edge: float = 0.05) -> NetworkMesh:
    """The network's version of a mesh, with about 60 % of `max_vertices` vertices.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        max_vertices: Most vertices of the result, at least 100.
        max_edge: Longest edge to leave unsplit, as a share of the largest extent.

    Raises:
        CharacterError: The mesh has no surface, or a coordinate is not finite (see `clean_mesh`).
    """
    if max_vertices < 100:
        raise CharacterError(f"a network mesh needs room for 100 vertices or more, not {max_vertices}")
    clean = clean_mesh(vertices, faces)
    area = float(vertex_areas(clean.vertices, clean.faces).sum())
    cell = float(np.clip(np.sqrt(_CELLS_PER_AREA * area / (0.6 * max_vertices)), _SMALLEST_CELL, _LARGEST_CELL))
    fine = _refined(clean, cell, max_edge)
    for attempt in range(24):
        patches = _patches(fine, cell, max_vertices, attempt > 12)
        count = len(patches.cells)
        if count > max_vertices:
            cell *= float(np.clip(np.sqrt(count / (0.9 * max_vertices)), 1.05, 1.5))
        elif count < 0.3 * max_vertices and attempt < 4 and cell > _SMALLEST_CELL:
            cell = max(_SMALLEST_CELL, cell * max(0.4, 0.9 * float(np.sqrt(count / (0.6 * max_vertices)))))
            fine = _refined(clean, cell, max_edge)
        else:
            break
    return _build(clean, fine, patches, cell)


@dataclass(frozen=True, eq=False)
class _Fine:
    """The clean mesh with its long edges split: what the grid merges."""

    vertices: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    areas: np.ndarray
    steps: tuple[csr_matrix, ...]  # its vertices from the clean ones, one product after the other
    start: np.ndarray  # where each clean vertex is among them


def _refined(clean: CleanMesh, cell: float, max_edge: float) -> _Fine:
    """Split the edges longer than a part of a cell. A mesh of too many needles is merged in a finer grid first."""
    points, faces = clean.vertices, clean.faces
    length = min(0.45 * cell, max_edge)
    start, steps = np.arange(len(points)), []
    if split_estimate(points, faces, length) > _MOST_SPLITS:
        start, _ = _inside_cells(points, unique_edges(faces, len(points)), cell / 2)
        steps.append(_mean_matrix(start, vertex_areas(points, faces) + 1e-12))
        points = steps[-1] @ points
        faces = distinct_faces(points, start[faces])
        while split_estimate(points, faces, length) > _MOST_SPLITS and length < 2:
            length *= 1.3
    whole = len(points)
    points, faces, rounds = split_long_edges(points, faces, length)
    if rounds:
        grown = identity(whole, format="csr")
        for pairs in rounds:
            rows = np.repeat(np.arange(len(pairs)), 2)
            half = csr_matrix((np.full(2 * len(pairs), 0.5), (rows, pairs.reshape(-1))), shape=(len(pairs), grown.shape[0]))
            grown = vstack([grown, half @ grown], format="csr")
        steps.append(grown)
    return _Fine(points, faces, unique_edges(faces, len(points)), vertex_areas(points, faces) + 1e-12, tuple(steps), start)


def _mean_matrix(label: np.ndarray, mass: np.ndarray) -> csr_matrix:
    """The matrix that takes values to their mass-weighted means over equal labels."""
    total = np.bincount(label, mass)
    return csr_matrix((mass / total[label], (label, np.arange(len(label)))), shape=(len(total), len(label)))


def _inside_cells(points: np.ndarray, edges: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Label of each point, the same where edges connect points inside one cell, and the key of the cell.

    0 is in the middle of a cell, so that symmetric meshes stay symmetric.
    """
    key = pack(np.rint(points / cell).astype(np.int64) + 100_000, 200_001)
    inside = edges[key[edges[:, 0]] == key[edges[:, 1]]]
    return mesh_parts(inside, len(points)), key


@dataclass(frozen=True, eq=False)
class _Patches:
    """What each network vertex stands for: the label of each fine vertex, and the middle of the cell of each label."""

    label: np.ndarray
    cells: np.ndarray


def _patches(fine: _Fine, cell: float, max_vertices: int, crowded: bool) -> _Patches:
    """The patches of the surface that become network vertices.

    Where loose parts are too many to keep a vertex each, the small ones, and when `crowded` all, merge with whatever shares
    their cell.
    """
    label, key = _inside_cells(fine.vertices, fine.edges, cell)
    if label.max() >= max_vertices:
        parts = mesh_parts(fine.edges, len(fine.vertices))
        number = int(parts.max()) + 1
        if crowded or number > max_vertices // 4:
            order = np.argsort(parts, kind="stable")
            starts = np.searchsorted(parts[order], np.arange(number))
            points = fine.vertices[order]
            extent = (np.maximum.reduceat(points, starts) - np.minimum.reduceat(points, starts)).max(axis=1)
            loose = crowded | (extent < 2 * cell)[parts] | (number > max_vertices)
            label = np.unique(np.where(loose, key, -1 - label), return_inverse=True)[1].reshape(-1)
    first = np.empty(int(label.max()) + 1, np.int64)
    first[label[::-1]] = np.arange(len(label))[::-1]
    cells = np.rint(fine.vertices[first] / cell) * cell
    return _absorb(fine, label, cells, cell)


def _absorb(fine: _Fine, label: np.ndarray, cells: np.ndarray, cell: float) -> _Patches:
    """Join patches of little area to the nearest larger one that they touch.

    A surface that grazes a corner of a cell leaves a crumb there; which crumbs there are is chance.
    """
    count = len(cells)
    areas = np.bincount(label, fine.areas, count)
    small = areas < _CRUMB * cell * cell
    ends = label[fine.edges]
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[small[ends[:, 0]] & ~small[ends[:, 1]]]
    if len(ends) == 0:
        return _Patches(label, cells)
    points = _mean_matrix(label, fine.areas) @ fine.vertices
    step = points[ends[:, 1]] - points[ends[:, 0]]
    # The second term decides between mirror images, which rounding would do otherwise.
    far = np.square(step).sum(axis=1) + 0.05 * cell * along(step)
    order = np.lexsort((far, ends[:, 0]))
    crumb, first = np.unique(ends[order, 0], return_index=True)
    target = np.arange(count)
    target[crumb] = ends[order, 1][first]
    kept, label = np.unique(target[label], return_inverse=True)
    return _Patches(label.reshape(-1), cells[kept])


def _soft_means(fine: _Fine, patches: _Patches, cell: float) -> tuple[csr_matrix, np.ndarray]:
    """The matrix of means over patches, (M, fine), and the area of each patch.

    A vertex near the border of two cells counts in both, half and half on the border itself, so that means do not jump when
    rounding moves it across. It counts only in patches that it or a neighbour is in.
    """
    label, ends = patches.label, fine.edges
    ends = ends[label[ends[:, 0]] != label[ends[:, 1]]]
    own = np.arange(len(label))
    members, where = np.concatenate([own, ends[:, 0], ends[:, 1]]), np.concatenate([label, label[ends[:, 1]], label[ends[:, 0]]])
    pairs = unpack_pairs(members * len(patches.cells) + where, len(patches.cells))
    vertex, patch = pairs.T
    off = np.abs(fine.vertices[vertex] - patches.cells[patch]) / cell
    share = np.clip((0.5 + _BORDER - off) / (2 * _BORDER), 0, 1).prod(axis=1) + 0.01 * (label[vertex] == patch)
    share *= (fine.areas / np.bincount(vertex, share))[vertex]
    areas = np.bincount(patch, share, len(patches.cells))
    return csr_matrix((share / areas[patch], (patch, vertex)), shape=(len(areas), len(label))), areas


def _build(clean: CleanMesh, fine: _Fine, patches: _Patches, cell: float) -> NetworkMesh:
    mean, areas = _soft_means(fine, patches, cell)
    points = mean @ fine.vertices
    order = canonical_order(points)
    label = canonical_rank(points)[patches.label]
    points, mean, areas = points[order], mean[order], areas[order]
    count = len(points)
    normals = mean @ (vertex_normals(fine.vertices, fine.faces, unit=False) / fine.areas[:, None])
    faces = distinct_faces(points, label[fine.faces])
    ends = label[fine.edges]
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    edges = unpack_pairs(ends[:, 0] * count + ends[:, 1], count)
    parts = mesh_parts(edges, count)
    bridges = bridge_edges(points, parts)

    spread = blend_matrix(clean.vertices, label[fine.start], points, faces, edges, 0.1 * cell)
    kept = np.flatnonzero(clean.used)
    times = np.bincount(clean.index[kept], minlength=len(clean.vertices))
    rows = clean.index[kept]
    original = csr_matrix((1 / times[rows], (rows, kept)), shape=(len(clean.vertices), len(clean.index)))
    return NetworkMesh(
        vertices=points.astype(np.float32),
        normals=normals.astype(np.float32),
        areas=areas.astype(np.float32),
        faces=faces,
        edges=np.concatenate([edges, bridges]),
        components=parts,
        center=clean.center,
        scale=clean.scale,
        _index=clean.index,
        _spread=spread,
        _gather=(original, *fine.steps, mean),
    )
