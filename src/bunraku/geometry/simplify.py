"""The mesh that the networks see: about the same resolution for every character, whatever its file holds.

Long edges are split, then the vertices are merged by the cells of a fixed grid, where only vertices that are connected
inside a cell merge: fingers, legs and the two sides of a sheet stay apart, and every loose part keeps at least one
vertex. Positions and normals are area-weighted means over the merged surface. Unlike edge collapses, whose order
decides their result, this depends on the shape nearly alone: another tessellation, a rounded coordinate or an opened
seam changes a mean a little and never starts an avalanche.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.errors import CharacterError
from bunraku.geometry.closest import Stars, blend_matrix, stars_of
from bunraku.geometry.graph import (
    CleanMesh,
    bridge_edges,
    canonical_order,
    canonical_rank,
    clean_mesh,
    distinct_faces,
    mesh_parts,
    unpack_pairs,
)
from bunraku.geometry.patches import FineMesh, Patches, find_patches, refine, soft_means
from bunraku.geometry.surface import vertex_areas

__all__ = ["NetworkMesh", "network_mesh", "network_views"]

_CELLS_PER_AREA = 1.12  # network vertices over the area in cell faces: 1.5 cells crossed on average, less the crumbs
_SMALLEST_CELL, _LARGEST_CELL = 1 / 2000, 0.08


@dataclass(frozen=True, eq=False)
class NetworkMesh:
    """A normalised mesh of network size, and the way between it and the vertices of the original.

    Args:
        vertices: Positions, the original's bounding box centred on 0 and its largest extent 1, shape (M, 3), float32.
        normals: Area-weighted mean normals of the surface that each vertex stands for, shape (M, 3), float32. Length 1
            where that is flat; shorter where it bends; near 0 where it closes on itself, as a thin finger does.
        areas: Surface that each vertex stands for, shape (M,), float32; sums to the area of the normalised mesh.
        faces: Vertex indices, shape (F, 3), int64.
        edges: Undirected edges, bridges between loose parts included, each once, smaller vertex first, shape (E, 2),
            int64.
        components: Loose part of each vertex, shape (M,), int64.
        cell: Size of the grid's cells, about the distance between neighbours.
        clean: The welded original.
        surface: It with its long edges split, from which the network's vertices are means.
        surface_label: The network vertex that each vertex of `surface` belongs to.
    """

    vertices: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    components: np.ndarray
    cell: float
    clean: CleanMesh = field(repr=False)
    surface: FineMesh = field(repr=False)
    surface_label: np.ndarray = field(repr=False)
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
        """Values of network vertices at every original vertex, shape (M, C) -> (V, C), float32.

        Barycentric at the nearest points of the network mesh around the vertex's own place in it, blended smoothly
        across edges. All weights are positive and sum to 1, so rows that sum to 1 stay so. Vertices at one position get
        one value.
        """
        return self.push_clean(values)[self.clean.index]

    def push_clean(self, values: np.ndarray) -> np.ndarray:
        """Values of network vertices at every vertex of `clean`, shape (M, C) -> (W, C), float32."""
        out: np.ndarray = self._spread @ np.asarray(values, np.float32)
        return out

    def push_surface(self, values: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Values of network vertices at some vertices of `surface`, shapes (M, C), (S,) -> (S, C), float32."""
        if len(where) == 0:
            return np.zeros((0, values.shape[1]), np.float32)
        out: np.ndarray = self._blend(self.surface.vertices[where], self.surface_label[where]) @ np.asarray(
            values, np.float32
        )
        return out

    def pull(self, values: np.ndarray) -> np.ndarray:
        """Values of original vertices as means over the surface of each network vertex, shape (V, C) -> (M, C),
        float32.
        """
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
        """Values of the vertices of another view of the same mesh (`network_views`) at this one's, shape (M', C) -> (M,
        C).
        """
        count = len(view.vertices)
        key, inverse = np.unique(self.surface_label * count + view.surface_label, return_inverse=True)
        shared = np.bincount(inverse, self.surface.areas)
        own, other = np.divmod(key, count)
        order = np.lexsort((-shared, own))
        home = other[order[np.unique(own[order], return_index=True)[1]]]
        out: np.ndarray = view._blend(self.vertices.astype(np.float64), home) @ np.asarray(values, np.float32)
        return out

    def _blend(self, points: np.ndarray, home: np.ndarray) -> csr_matrix:
        """Weights of this mesh's vertices at points (P, 3) near its vertices `home` (P,)."""
        return blend_matrix(points, home, self._stars, 0.1 * self.cell)

    @cached_property
    def _stars(self) -> Stars:
        own = self.edges[self.components[self.edges[:, 0]] == self.components[self.edges[:, 1]]]
        return stars_of(self.vertices.astype(np.float64), self.faces, own)

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
    """The network's version of a mesh, with about 60 % of `max_vertices` vertices.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        max_vertices: Most vertices of the result, at least 100.
        max_edge: Longest edge to leave unsplit, as a share of the largest extent.
        offset: Of the grid, in cells; gives another tessellation of the same surface.

    Raises:
        CharacterError: The mesh has no surface, or a coordinate is not finite (see `clean_mesh`).
    """
    return network_views(vertices, faces, max_vertices, max_edge, (offset,))[0]


def network_views(
    vertices: np.ndarray,
    faces: np.ndarray,
    max_vertices: int = 4000,
    max_edge: float = 0.05,
    offsets: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 0.0),),
) -> list[NetworkMesh]:
    """Network meshes of one mesh by grids of the same cells that lie differently, for the price of little more than
    one.

    Arguments and errors are those of `network_mesh`, with one offset for each result. The first decides the size of the
    cells, so that others may have a few more vertices than `max_vertices`.
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
