"""The apparel graph: a few nodes spread over every part, their neighbours within it, where the part is held, and what
of them never changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.geometry.graph import clean_mesh, unique_edges

__all__ = [
    "NEIGHBOURS",
    "ApparelNodes",
    "apparel_nodes",
    "held_vertices",
    "part_lengths",
    "part_neighbours",
    "surface_distances",
]

NEIGHBOURS = 6
LEAST = 3  # nodes of a part
HELD = 0.08  # of a part's extent: vertices as near to what holds it are held


@dataclass(frozen=True, eq=False)
class ApparelNodes:
    """M nodes of a clothed character's apparel.

    Args:
        vertex: Vertex that each is, shape (M,).
        rest: Position in the rest pose [m], shape (M, 3).
        joint: Joint that carries each, shape (M,).
        weights: Skinning weights of each, shape (M, 22).
        part: Part of each, shape (M,).
        neighbours: Nearest nodes of the same part, itself where there are too few, shape (M, NEIGHBOURS).
        held: From where its part is held to the node [m], shape (M, 3).
        distance: Along the surface from where the part is held [m], shape (M,).
        length: The largest such distance in its part [m], shape (M,).
    """

    vertex: np.ndarray
    rest: np.ndarray
    joint: np.ndarray
    weights: np.ndarray
    part: np.ndarray
    neighbours: np.ndarray
    held: np.ndarray
    distance: np.ndarray
    length: np.ndarray

    def __len__(self) -> int:
        return len(self.vertex)


def apparel_nodes(clothed: ClothedCharacter, most: int = 256) -> ApparelNodes:
    """Choose nodes: at least three of every part, the rest where the gaps are widest (farthest points).

    Args:
        clothed: The character.
        most: How many; small apparel has fewer.
    """
    cloth = np.flatnonzero(clothed.part >= 0)
    points, parts = clothed.rest[cloth].astype(np.float64), clothed.part[cloth]
    held, distance, length = _attachment(clothed)
    chosen = _spread(points, parts, most)
    vertex = cloth[chosen]
    joint = clothed.weights[vertex].argmax(axis=1)
    return ApparelNodes(
        vertex, clothed.rest[vertex].astype(np.float32), joint, clothed.weights[vertex].astype(np.float32),
        clothed.part[vertex], part_neighbours(points[chosen], parts[chosen]), held[vertex].astype(np.float32),
        distance[vertex].astype(np.float32), length[vertex].astype(np.float32),
    )  # fmt: skip


def part_lengths(clothed: ClothedCharacter) -> np.ndarray:
    """How far the farthest vertex of each part is from where it is held, along the surface [m], shape (P,)."""
    out = np.full(len(clothed.stiffness), 0.1, np.float32)
    cloth = clothed.part >= 0
    out[clothed.part[cloth]] = _attachment(clothed)[2][cloth]
    return out


def surface_distances(clothed: ClothedCharacter) -> np.ndarray:
    """How far each vertex is from where its part is held, along the surface [m], shape (V,); 0 on the body."""
    return _attachment(clothed)[1]


def held_vertices(clothed: ClothedCharacter) -> np.ndarray:
    """Apparel vertices where their parts are held, shape (H,)."""
    cloth = clothed.part >= 0
    return np.flatnonzero(cloth & (_attachment(clothed)[1] <= 0))


def _spread(points: np.ndarray, parts: np.ndarray, most: int) -> np.ndarray:
    """Farthest points, the first three of every part before the others; the order is such that any head of it is
    spread too.
    """
    gap = np.full(len(points), np.inf)
    chosen: list[int] = []

    def take(index: int) -> None:
        chosen.append(index)
        own = parts == parts[index]  # parts do not pass messages to one another
        gap[own] = np.minimum(gap[own], np.square(points[own] - points[index]).sum(axis=1))

    order = np.argsort(-np.bincount(parts), kind="stable")
    for part in order:
        rows = np.flatnonzero(parts == part)
        if not len(rows):
            continue
        take(int(rows[np.square(points[rows] - points[rows].mean(axis=0)).sum(axis=1).argmax()]))
        for _ in range(min(LEAST, len(rows)) - 1):
            take(int(rows[gap[rows].argmax()]))
    while len(chosen) < min(most, len(points)):
        far = int(gap.argmax())
        if gap[far] <= 1e-12:  # the rest are doubles
            break
        take(far)
    return np.array(chosen, np.int64)


def part_neighbours(points: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """The nearest other points of the same part, nearest first; the point itself where there are too few.

    Args:
        points: [m], shape (M, 3).
        parts: Part of each, shape (M,).

    Returns:
        Shape (M, NEIGHBOURS).
    """
    out = np.repeat(np.arange(len(points))[:, None], NEIGHBOURS, axis=1)
    for part in np.unique(parts):
        rows = np.flatnonzero(parts == part)
        near = min(NEIGHBOURS + 1, len(rows))
        own = rows[cKDTree(points[rows]).query(points[rows], near)[1].reshape(len(rows), near)]
        itself = own == rows[:, None]
        itself[~itself.any(axis=1), -1] = True  # of points at one position, a few may not find themselves
        out[rows, : near - 1] = own[~itself].reshape(len(rows), near - 1)
    return out


def _attachment(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every vertex: the vector from where its part is held, the distance from there along the surface, and the
    largest such distance in the part; 0 on the body.

    A part is held at its vertices that share an edge with the body, or else at those that are nearest to it.
    """
    clean = clean_mesh(clothed.rest, clothed.faces)
    count = len(clean.vertices)
    points = clean.vertices * clean.scale
    part = np.full(count, -1, np.int64)
    cloth = clothed.part >= 0
    part[clean.index[cloth]] = clothed.part[cloth]
    edges = unique_edges(clean.faces, count)
    inside = edges[(part[edges[:, 0]] == part[edges[:, 1]]) & (part[edges[:, 0]] >= 0)]
    border = edges[(part[edges] >= 0).sum(axis=1) == 1]
    seam = np.unique(border[part[border] >= 0]) if len(border) else np.zeros(0, np.int64)
    lengths = np.linalg.norm(points[inside[:, 0]] - points[inside[:, 1]], axis=1) + 1e-9
    graph = coo_matrix((lengths, (inside[:, 0], inside[:, 1])), shape=(count, count)).tocsr()
    body = points[part < 0]
    tree = cKDTree(body) if len(body) else None
    held, distance, longest = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for number in range(int(part.max(initial=-1)) + 1):
        rows = np.flatnonzero(part == number)
        if not len(rows):
            continue
        starts = seam[part[seam] == number]
        extent = float(np.linalg.norm(np.ptp(points[rows], axis=0)))
        if not len(starts) and tree is not None:
            gap = tree.query(points[rows])[0]
            # of two ends that are as near, such as a scarf's, the upper one holds
            upper = points[rows, 1].max() - points[rows, 1]
            gap = gap + 0.15 * upper
            starts = rows[gap <= gap.min() + HELD * extent]
        if not len(starts):
            starts = rows[points[rows, 1] >= points[rows, 1].max() - HELD * extent]
        along, _, source = dijkstra(graph, directed=False, indices=starts, min_only=True, return_predecessors=True)
        reached = np.isfinite(along[rows])
        anchor = np.where(reached, source[rows], starts[0])
        held[rows] = points[rows] - points[anchor]
        distance[rows] = np.where(reached, along[rows], np.linalg.norm(held[rows], axis=1))
        longest[rows] = max(float(distance[rows].max()), 1e-4)
    return held[clean.index], distance[clean.index], longest[clean.index]
