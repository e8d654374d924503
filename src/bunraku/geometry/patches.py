"""The patches of a surface that become the vertices of the network mesh: long edges split, then the cells of a fixed
grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack

from bunraku.geometry.graph import CleanMesh, along, distinct_faces, mesh_parts, pack, unique_edges, unpack_pairs
from bunraku.geometry.subdivision import split_estimate, split_long_edges
from bunraku.geometry.surface import vertex_areas, vertex_normals

__all__ = ["FineMesh", "Patches", "find_patches", "refine", "soft_means"]

_MOST_SPLITS = 150_000
_MANY = 60_000  # vertices, more than any view needs
_FINE = 5  # cells of the grid in which so many are merged, over one of a view's
_CRUMB = 0.25  # area under which a patch joins its neighbour, in cell faces
_BORDER = 0.15  # half the width of the zone in which a vertex counts in two cells, in cells


@dataclass(frozen=True, eq=False)
class FineMesh:
    """The clean mesh with its long edges split: what the grid merges.

    Args:
        vertices: Positions, shape (S, 3), float64.
        faces: Vertex indices, shape (F, 3).
        edges: Undirected edges, shape (E, 2).
        areas: Surface of each vertex, shape (S,).
        normals: Its mean normal, shorter where it bends, shape (S, 3).
        steps: Matrices that make its vertices from the clean ones, one product after the other.
        start: Where each clean vertex is among its vertices, shape (W,).
    """

    vertices: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    areas: np.ndarray
    normals: np.ndarray
    steps: tuple[csr_matrix, ...]
    start: np.ndarray

    @cached_property
    def parts(self) -> np.ndarray:
        """Loose part of each vertex, shape (S,), int64."""
        return mesh_parts(self.edges, len(self.vertices))


def refine(clean: CleanMesh, cell: float, max_edge: float) -> FineMesh:
    """Split the edges longer than a part of a cell. A mesh of too many needles is merged in a finer grid first, and so
    is one of very many vertices, in a grid so fine that it hardly matters.
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
    whole = len(points)
    points, faces, rounds = split_long_edges(points, faces, length)
    if rounds:
        grown = identity(whole, format="csr")
        for pairs in rounds:
            rows = np.repeat(np.arange(len(pairs)), 2)
            half = csr_matrix(
                (np.full(2 * len(pairs), 0.5), (rows, pairs.reshape(-1))), shape=(len(pairs), grown.shape[0])
            )
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
    """Label of each point, the same where edges connect points inside one cell, and the key of the cell.

    Without an offset, 0 is in the middle of a cell, so that symmetric meshes stay symmetric.
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
    """The patches of the surface that become network vertices.

    Where loose parts are too many to keep a vertex each, the small ones, and when `crowded` all, merge with whatever
    shares their cell.

    Args:
        fine: The mesh with its long edges split.
        cell: Size of a cell.
        max_vertices: Most patches wanted; there may be more.
        crowded: Whether large loose parts may merge too.
        offset: Of the grid, in cells, shape (3,).
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
    when rounding moves it across. It counts only in patches that it or a neighbour is in.
    """
    label, ends = patches.label, fine.edges
    ends = ends[label[ends[:, 0]] != label[ends[:, 1]]]
    own = np.arange(len(label))
    members, where = (
        np.concatenate([own, ends[:, 0], ends[:, 1]]),
        np.concatenate([label, label[ends[:, 1]], label[ends[:, 0]]]),
    )
    pairs = unpack_pairs(members * len(patches.cells) + where, len(patches.cells))
    vertex, patch = pairs.T
    off = np.abs(fine.vertices[vertex] - patches.cells[patch]) / cell
    share = np.clip((0.5 + _BORDER - off) / (2 * _BORDER), 0, 1).prod(axis=1) + 0.01 * (label[vertex] == patch)
    share *= (fine.areas / np.bincount(vertex, share))[vertex]
    areas = np.bincount(patch, share, len(patches.cells))
    return csr_matrix((share / areas[patch], (patch, vertex)), shape=(len(areas), len(label))), areas
