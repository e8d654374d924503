"""The mesh that the networks see: about the same resolution for every character, built from patches of its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack

from bunraku.core.geometry.closest import Stars, blend_matrix, stars_of
from bunraku.core.geometry.graph import (
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
from bunraku.core.geometry.surface import split_estimate, split_long_edges, vertex_areas, vertex_normals
from bunraku.errors import CharacterError

_MOST_SPLITS = 150_000
_MANY = 60_000  # vertices, more than any view needs
_FINE = 5  # cells of the grid in which so many are merged, over one of a view's

# The shipped networks of handles were trained on meshes made with both.
_CRUMB = 0.25  # area under which a patch joins its neighbour, in cell faces
_BORDER = 0.15  # half the width of the zone in which a vertex counts in two cells, in cells


@dataclass(frozen=True, eq=False)
class FineMesh:
    """The clean mesh with its long edges split, which the grid merges."""

    vertices: np.ndarray  # positions, shape (S, 3), float64
    faces: np.ndarray  # vertex indices, shape (F, 3)
    edges: np.ndarray  # undirected edges, shape (E, 2)
    areas: np.ndarray  # surface of each vertex, shape (S,)
    normals: np.ndarray  # its mean normal, shorter where it bends, shape (S, 3)
    steps: tuple[csr_matrix, ...]  # matrices that make its vertices from the clean ones, one product after the other
    start: np.ndarray  # vertex of each clean vertex, shape (W,)

    @cached_property
    def parts(self) -> np.ndarray:
        """Loose part of each vertex, shape (S,), int64."""
        return mesh_parts(self.edges, len(self.vertices))


def refine(clean: CleanMesh, cell: float, max_edge: float) -> FineMesh:
    """Split the edges longer than a part of a cell. A mesh of too many needles, or of very many vertices, is merged in
    a finer grid first.
    """
    points, faces = clean.vertices, clean.faces
    length = min(0.45 * cell, max_edge)
    start, steps = np.arange(len(points)), []
    edges = unique_edges(faces, len(points))

    def merge(size: float) -> None:
        nonlocal points, faces, edges, start
        label, _ = _inside_cells(points, edges, size)
        steps.append(_mean_matrix(label, vertex_areas(points, faces) + 1e-12))
        points = steps[-1] @ points
        faces = distinct_faces(points, label[faces])
        edges, start = unique_edges(faces, len(points)), label[start]

    if len(points) > _MANY:
        merge(cell / _FINE)
    if _longest(points, edges) <= 2 / 3 * length:  # so short that nothing is split
        return _fine(points, faces, edges, tuple(steps), start)
    if split_estimate(points, faces, length) > _MOST_SPLITS:
        merge(cell / 2)
        while split_estimate(points, faces, length) > _MOST_SPLITS and length < 2:
            length *= 1.3
    count = len(points)
    points, faces, rounds = split_long_edges(points, faces, length)
    if rounds:
        grown = identity(count, format="csr")
        for pairs in rounds:
            rows = np.repeat(np.arange(len(pairs)), 2)
            entries = np.full(2 * len(pairs), 0.5), (rows, pairs.reshape(-1))
            half = csr_matrix(entries, shape=(len(pairs), grown.shape[0]))
            grown = vstack([grown, half @ grown], format="csr")
        steps.append(grown)
    return _fine(points, faces, unique_edges(faces, len(points)), tuple(steps), start)


def _longest(points: np.ndarray, edges: np.ndarray) -> float:
    """Length of the longest edge."""
    return float(np.sqrt(np.square(points[edges[:, 0]] - points[edges[:, 1]]).sum(axis=1).max(initial=0)))


def _fine(
    points: np.ndarray, faces: np.ndarray, edges: np.ndarray, steps: tuple[csr_matrix, ...], start: np.ndarray
) -> FineMesh:
    areas = vertex_areas(points, faces) + 1e-12
    normals = vertex_normals(points, faces, unit=False) / areas[:, None]
    return FineMesh(points, faces, edges, areas, normals, steps, start)


def _mean_matrix(label: np.ndarray, mass: np.ndarray) -> csr_matrix:
    """The matrix that takes values to their mass-weighted means over equal labels."""
    total = np.bincount(label, mass)
    return csr_matrix((mass / total[label], (label, np.arange(len(label)))), shape=(len(total), len(label)))


def _inside_cells(
    points: np.ndarray, edges: np.ndarray, cell: float, offset: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Label of each point, the same where edges connect points inside one cell, and the key of the cell. Without an
    offset, 0 is in the middle of a cell, so that symmetric meshes stay symmetric.
    """
    key = pack(np.rint(points / cell - offset).astype(np.int64) + 100_000, 200_001)
    inside = edges[key[edges[:, 0]] == key[edges[:, 1]]]
    return mesh_parts(inside, len(points)), key


@dataclass(frozen=True, eq=False)
class Patches:
    """What each network vertex stands for: the label of each fine vertex, and the middle of the cell of each label."""

    label: np.ndarray
    cells: np.ndarray


def find_patches(
    fine: FineMesh, cell: float, max_vertices: int, crowded: bool, offset: np.ndarray | float = 0.0
) -> Patches:
    """The patches of the surface in a grid with an offset [cells] that become network vertices, at most `max_vertices`
    if possible.

    Where loose parts are too many to keep a vertex each, the small ones, and when `crowded` all, merge with whatever
    shares their cell.
    """
    label, key = _inside_cells(fine.vertices, fine.edges, cell, offset)
    if label.max() >= max_vertices:
        parts = fine.parts
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
    cells = (np.rint(fine.vertices[first] / cell - offset) + offset) * cell
    return _absorb(fine, label, cells, cell)


def _absorb(fine: FineMesh, label: np.ndarray, cells: np.ndarray, cell: float) -> Patches:
    """Join patches of little area to the nearest larger one that they touch: where a surface grazes a corner of a cell,
    it leaves crumbs by chance.
    """
    count = len(cells)
    areas = np.bincount(label, fine.areas, count)
    small = areas < _CRUMB * cell * cell
    ends = label[fine.edges]
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[small[ends[:, 0]] & ~small[ends[:, 1]]]
    if len(ends) == 0:
        return Patches(label, cells)
    points = _mean_matrix(label, fine.areas) @ fine.vertices
    step = points[ends[:, 1]] - points[ends[:, 0]]
    # The second term decides between mirror images, which rounding would do otherwise.
    far = np.square(step).sum(axis=1) + 0.05 * cell * along(step)
    order = np.lexsort((far, ends[:, 0]))
    crumb, first = np.unique(ends[order, 0], return_index=True)
    target = np.arange(count)
    target[crumb] = ends[order, 1][first]
    kept, label = np.unique(target[label], return_inverse=True)
    return Patches(label.reshape(-1), cells[kept])


def soft_means(fine: FineMesh, patches: Patches, cell: float) -> tuple[csr_matrix, np.ndarray]:
    """The matrix of means over patches, (M, fine), and the area of each patch.

    A vertex near the border of two cells counts in both, half and half on the border itself, so that means do not jump
    when rounding moves it across; but only in patches that it or a neighbour is in.
    """
    label, ends = patches.label, fine.edges
    ends = ends[label[ends[:, 0]] != label[ends[:, 1]]]
    columns = np.arange(len(label))
    members = np.concatenate([columns, ends[:, 0], ends[:, 1]])
    where = np.concatenate([label, label[ends[:, 1]], label[ends[:, 0]]])
    pairs = unpack_pairs(members * len(patches.cells) + where, len(patches.cells))
    vertex, patch = pairs.T
    off = np.abs(fine.vertices[vertex] - patches.cells[patch]) / cell
    share = np.clip((0.5 + _BORDER - off) / (2 * _BORDER), 0, 1).prod(axis=1) + 0.01 * (label[vertex] == patch)
    share *= (fine.areas / np.bincount(vertex, share))[vertex]
    areas = np.bincount(patch, share, len(patches.cells))
    return csr_matrix((share / areas[patch], (patch, vertex)), shape=(len(areas), len(label))), areas


# network vertices over the area in cell faces: 1.5 cells crossed on average, less the crumbs; measured on the six
# samples: 1.07 to 1.08
_CELLS_PER_AREA = 1.12
_SMALLEST_CELL, _LARGEST_CELL = 1 / 2000, 0.08


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """A normalised mesh of network size, and the maps between it and the vertices of the original."""

    # positions, the original's bounding box centred on 0 and its largest extent 1, shape (M, 3), float32
    vertices: np.ndarray
    # area-weighted mean normals of the surface that each vertex stands for, shape (M, 3), float32: of length 1 where
    # that is flat, shorter where it bends, near 0 where it closes on itself, as a thin finger does
    normals: np.ndarray
    # surface that each vertex stands for, shape (M,), float32; sums to the area of the normalised mesh
    areas: np.ndarray
    faces: np.ndarray  # vertex indices, shape (F, 3), int64
    # undirected edges, bridges between loose parts included, each once, smaller vertex first, shape (E, 2), int64
    edges: np.ndarray
    components: np.ndarray  # loose part of each vertex, shape (M,), int64
    cell: float  # size of the grid's cells, about the distance between neighbours
    clean: CleanMesh = field(repr=False)  # the welded original
    # the same with its long edges split, of which the network's vertices are means
    surface: FineMesh = field(repr=False)
    surface_label: np.ndarray = field(repr=False)  # the network vertex of each vertex of `surface`
    _mean: csr_matrix = field(repr=False)

    @property
    def center(self) -> np.ndarray:
        """Centre of the original's bounding box [m], shape (3,), float64."""
        return self.clean.center

    @property
    def scale(self) -> float:
        """Largest extent of the original [m]: original = vertices * scale + center."""
        return self.clean.scale

    def push(self, values: np.ndarray) -> np.ndarray:
        """Values of network vertices at every original vertex, shape (M, C) -> (V, C), float32: barycentric at the
        nearest points of the network mesh, blended smoothly across edges. Weights are positive and sum to 1, so rows
        that sum to 1 stay so. Vertices at one position get one value.
        """
        return self.push_clean(values)[self.clean.index]

    def push_clean(self, values: np.ndarray) -> np.ndarray:
        """Values of network vertices at every vertex of `clean`, shape (M, C) -> (W, C), float32."""
        return np.asarray(self._spread @ np.asarray(values, np.float32))

    def push_surface(self, values: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values of network vertices at some vertices of `surface`, shapes (M, C), (S,) -> (S, C), float32."""
        if len(where) == 0:
            return np.zeros((0, values.shape[1]), np.float32)
        blend = self._blend(self.surface.vertices[where], self.surface_label[where])
        return np.asarray(blend @ np.asarray(values, np.float32))

    def pull(self, values: np.ndarray) -> np.ndarray:
        """Mean values of original vertices over the surface of each network vertex, shape (V, C) -> (M, C), float32."""
        clean = self.clean
        kept = np.flatnonzero(clean.used)
        rows = clean.index[kept]
        times = np.bincount(rows, minlength=len(clean.vertices))
        original = csr_matrix((1 / times[rows], (rows, kept)), shape=(len(clean.vertices), len(clean.index)))
        out = np.asarray(values, np.float64)
        for matrix in (original, *self.surface.steps, self._mean):
            out = matrix @ out
        return out.astype(np.float32)

    def carry(self, values: np.ndarray, view: NetworkMesh) -> np.ndarray:
        """Values of another view of the same mesh (`network_views`) at this one's vertices, shape (M', C) -> (M, C)."""
        count = len(view.vertices)
        key, inverse = np.unique(self.surface_label * count + view.surface_label, return_inverse=True)
        shared = np.bincount(inverse, self.surface.areas)
        first, other = np.divmod(key, count)
        order = np.lexsort((-shared, first))
        home = other[order[np.unique(first[order], return_index=True)[1]]]
        return np.asarray(view._blend(self.vertices.astype(np.float64), home) @ np.asarray(values, np.float32))

    def _blend(self, points: np.ndarray, home: np.ndarray) -> csr_matrix:
        """Weights of this mesh's vertices at points (P, 3) near its vertices `home` (P,)."""
        return blend_matrix(points, home, self._stars, 0.1 * self.cell)

    @cached_property
    def _stars(self) -> Stars:
        inner = self.edges[self.components[self.edges[:, 0]] == self.components[self.edges[:, 1]]]
        return stars_of(self.vertices.astype(np.float64), self.faces, inner)

    @cached_property
    def _spread(self) -> csr_matrix:
        return self._blend(self.clean.vertices, self.surface_label[self.surface.start])


def network_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    max_vertices: int = 4000,
    max_edge: float = 0.05,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> NetworkMesh:
    """The network's version of a mesh of vertices [m] (V, 3) and faces (F, 3), with about 60 % of `max_vertices` (at
    least 100). Edges up to a share of the largest extent are not split; another offset of the grid [cells] gives
    another tessellation. CharacterError if the mesh has no surface, or a coordinate is not finite (see `clean_mesh`).
    """
    return network_views(vertices, faces, max_vertices, max_edge, (offset,))[0]


def network_views(
    vertices: np.ndarray,
    faces: np.ndarray,
    max_vertices: int = 4000,
    max_edge: float = 0.05,
    offsets: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 0.0),),
) -> list[NetworkMesh]:
    """`network_mesh` with several offsets of the grid, for little more than the price of one. The first decides the
    size of the cells, so that others may have a few more vertices than `max_vertices`.
    """
    if max_vertices < 100:
        raise CharacterError(f"a network mesh needs room for 100 vertices or more, not {max_vertices}")
    clean = clean_mesh(vertices, faces)
    area = float(vertex_areas(clean.vertices, clean.faces).sum())
    cell = float(np.clip(np.sqrt(_CELLS_PER_AREA * area / (0.6 * max_vertices)), _SMALLEST_CELL, _LARGEST_CELL))
    fine = refine(clean, cell, max_edge)
    first, *others = (np.asarray(offset, np.float64) for offset in offsets)
    for attempt in range(24):
        crowded = attempt > 12
        patches = find_patches(fine, cell, max_vertices, crowded, first)
        count = len(patches.cells)
        if count > max_vertices:
            cell *= float(np.clip(np.sqrt(count / (0.9 * max_vertices)), 1.05, 1.5))
        elif count < 0.3 * max_vertices and attempt < 4 and cell > _SMALLEST_CELL:
            cell = max(_SMALLEST_CELL, cell * max(0.4, 0.9 * float(np.sqrt(count / (0.6 * max_vertices)))))
            fine = refine(clean, cell, max_edge)
        else:
            break
    return [
        _build(clean, fine, p, cell)
        for p in (patches, *(find_patches(fine, cell, max_vertices, crowded, offset) for offset in others))
    ]


def _build(clean: CleanMesh, fine: FineMesh, patches: Patches, cell: float) -> NetworkMesh:
    mean, areas = soft_means(fine, patches, cell)
    points = mean @ fine.vertices
    order = canonical_order(points)
    label = canonical_rank(points)[patches.label]
    points, mean, areas = points[order], mean[order], areas[order]
    count = len(points)
    faces = distinct_faces(points, label[fine.faces])
    ends = label[fine.edges]
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    edges = unpack_pairs(ends[:, 0] * count + ends[:, 1], count)
    parts = mesh_parts(edges, count)
    return NetworkMesh(
        vertices=points.astype(np.float32),
        normals=(mean @ fine.normals).astype(np.float32),
        areas=areas.astype(np.float32),
        faces=faces,
        edges=np.concatenate([edges, bridge_edges(points, parts)]),
        components=parts,
        cell=cell,
        clean=clean,
        surface=fine,
        surface_label=label,
        _mean=mean,
    )
