"""The apparel graph: the separate pieces of apparel, a few nodes on each, their neighbours, how they swing, and the
network layer on them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import FREE, NARROW, ClothedCharacter, Swing, guessed_swing, part_stiffness
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.nn.layers import Linear, Norm, Weights, gelu, normed

MOSTLY = 0.4  # of a loose piece's points: a piece of which so many are apparel is apparel; chosen by eye
LARGE = 0.3  # of all points: a piece with more may be the body itself; chosen by eye


def whole_pieces(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> np.ndarray:
    """Number of the loose piece of the mesh of each vertex where much of that is apparel, -1 elsewhere, shape (V,). A
    lock of hair whose upper half is not marked hangs on the head all the same, whatever arm lies beside it.
    CharacterError if the mesh is broken.

    Args:
        vertices, faces: Rest mesh [m], shapes (V, 3) and (F, 3).
        apparel: The mask, shape (V,), bool.
    """
    index, edges, cloth = _welded(vertices, faces, apparel)
    count = len(cloth)
    piece = mesh_parts(edges, count)
    sizes = np.bincount(piece)
    share = np.bincount(piece, cloth) / np.maximum(sizes, 1)
    mostly = (share >= MOSTLY) & (sizes < LARGE * count)
    number = piece[index]
    return np.asarray(np.where(mostly[number], number, -1))


def apparel_parts(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> np.ndarray:
    """Number of the apparel part of each vertex, -1 on the body, shape (V,), int32, in the order of the parts' first
    vertices. Vertices at one position are one, so seams of the file part nothing. Arguments and errors as of
    `whole_pieces`.
    """
    index, edges, cloth = _welded(vertices, faces, apparel)
    part = mesh_parts(edges[cloth[edges].all(axis=1)], len(cloth))[index]
    out = np.full(len(vertices), -1, np.int32)
    _, first, number = np.unique(part[apparel], return_index=True, return_inverse=True)
    out[apparel] = np.argsort(np.argsort(first))[number.reshape(-1)]
    return out


def _welded(vertices: np.ndarray, faces: np.ndarray, apparel: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point of each vertex (V,), one for each position; edges of points (E, 2); and the points of apparel (P,)."""
    clean = clean_mesh(vertices, faces)
    cloth = np.zeros(len(clean.vertices), bool)
    cloth[clean.index[apparel]] = True
    return clean.index, unique_edges(clean.faces, len(cloth)), cloth


NEIGHBOURS = 6  # of a node, or of another point of apparel, as the networks were trained
LEAST = 3  # nodes of a part, as the networks were trained
HELD = 0.08  # of a part's extent: vertices as near to what holds it are held, as the networks were trained


@dataclass(frozen=True, eq=False)
class ApparelNodes:
    """M nodes of a clothed character's apparel."""

    vertex: np.ndarray  # vertex that each is, shape (M,)
    rest: np.ndarray  # position in the rest pose [m], shape (M, 3)
    joint: np.ndarray  # joint that carries each, shape (M,)
    weights: np.ndarray  # skinning weights of each, shape (M, 22)
    part: np.ndarray  # part of each, shape (M,)
    # nearest nodes of the same part, the node itself where there are too few, shape (M, NEIGHBOURS)
    neighbours: np.ndarray
    held: np.ndarray  # from where its part is held to the node [m], shape (M, 3)
    distance: np.ndarray  # along the surface from where the part is held [m], shape (M,)
    length: np.ndarray  # the largest such distance in its part [m], shape (M,)

    def __len__(self) -> int:
        return len(self.vertex)


def apparel_nodes(clothed: ClothedCharacter, most: int = 256) -> ApparelNodes:
    """At most this many nodes: at least three of every part, the rest where the gaps are widest (farthest points)."""
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
    """Distance of the farthest vertex of each part from where it is held, along the surface [m], shape (P,)."""
    out = np.full(len(clothed.stiffness), 0.1, np.float32)
    cloth = clothed.part >= 0
    out[clothed.part[cloth]] = _attachment(clothed)[2][cloth]
    return out


def held_vertices(clothed: ClothedCharacter) -> np.ndarray:
    """Apparel vertices where their parts are held, shape (H,)."""
    cloth = clothed.part >= 0
    return np.flatnonzero(cloth & (_attachment(clothed)[1] <= 0))


def _spread(points: np.ndarray, parts: np.ndarray, most: int) -> np.ndarray:
    """Farthest points, the first three of every part before the others; any head of the order is spread too."""
    gap = np.full(len(points), np.inf)
    chosen: list[int] = []

    def take(index: int) -> None:
        chosen.append(index)
        same_part = parts == parts[index]  # parts do not pass messages to one another
        gap[same_part] = np.minimum(gap[same_part], np.square(points[same_part] - points[index]).sum(axis=1))

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
    """The nearest other points [m] (M, 3) of the same part, or the point itself, shape (M, NEIGHBOURS)."""
    out = np.repeat(np.arange(len(points))[:, None], NEIGHBOURS, axis=1)
    for part in np.unique(parts):
        rows = np.flatnonzero(parts == part)
        near = min(NEIGHBOURS + 1, len(rows))
        nearest = rows[cKDTree(points[rows]).query(points[rows], near)[1].reshape(len(rows), near)]
        itself = nearest == rows[:, None]
        itself[~itself.any(axis=1), -1] = True  # of points at one position, a few may not find themselves
        out[rows, : near - 1] = nearest[~itself].reshape(len(rows), near - 1)
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


def clothed_with_springs(
    clothed: ClothedCharacter, spring: np.ndarray, mass: np.ndarray, limit: np.ndarray, dial: float = 1.0,
    swing: Swing | None = None,
) -> ClothedCharacter:  # fmt: skip
    """A clothed character whose parts are as stiff as a file says: by the spring of a joint [N m / rad], the mass of a
    body [kg] and the limit of a joint [rad] of each part, shape (P,), and the swing of its vertices, where it is known.
    `dial` is a factor on the stiffness; limits are narrower by its root.
    """
    limit = np.clip(limit, NARROW, FREE).astype(np.float32)
    stiffness = part_stiffness(spring, mass, part_lengths(clothed), dial, limit)
    rows = None if swing is None else swing.dialled(dial).rows()
    return replace(clothed, stiffness=stiffness, limit=limit, swing=rows)


def node_swing(clothed: ClothedCharacter, nodes: ApparelNodes) -> Swing:
    """How nodes of a character swing: as its file says, or else as the stiffness of their parts would mean."""
    if clothed.swing is not None:
        return Swing.of_rows(clothed.swing[nodes.vertex])
    return guessed_swing(nodes.held, clothed.stiffness[nodes.part], clothed.damping[nodes.part])


@dataclass(frozen=True, eq=False)
class NodeGraph:
    """Neighbours (M, K) and parts (M,), by any numbers from 0, of M points of one mesh."""

    neighbours: np.ndarray
    part: np.ndarray

    @cached_property
    def _runs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points in the order of their parts, where each part begins in it, and the index of each point's part."""
        order = np.argsort(self.part, kind="stable")
        _, starts, index = np.unique(self.part[order], return_index=True, return_inverse=True)
        number = np.empty(len(order), np.int64)
        number[order] = index
        return order, starts, number

    @cached_property
    def _ranks(self) -> tuple[np.ndarray, ...]:
        return tuple(np.ascontiguousarray(column) for column in self.neighbours.T)

    def largest_neighbour(self, values: np.ndarray) -> np.ndarray:
        """The largest of each channel among a point and its neighbours, shape (M, C)."""
        best = values.copy()
        for rank in self._ranks:
            np.maximum(best, values[rank], out=best)
        return best

    def largest_of_part(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The largest of each channel in each part with points, (P, C), and the row of each point's part, (M,)."""
        order, starts, number = self._runs
        return np.maximum.reduceat(values[order], starts, axis=0), number


class EdgeBlock:
    """An edge convolution within parts, with the maxima of the whole part, added to its input (Eq. 13 of MMDMC).

    The convolution is (W1 - W2) x_i + b + max_j W2 x_j, whose two maps of the point itself are one. `width` is its
    channels.
    """

    def __init__(self, width: int, weights: Weights):
        itself = weights.linear("edge.own", width, width)
        self.neighbour: Linear = weights.linear("edge.neighbour", width, width, bias=False)
        self.own = Linear(itself.matrix - self.neighbour.matrix, itself.bias)
        self.pooled: Linear = weights.linear("pooled", width, width, bias=False)
        self.norm: Norm = weights.norm("norm", width)

    def __call__(self, x: np.ndarray, graph: NodeGraph) -> np.ndarray:
        """Shape (M, C) -> (M, C)."""
        largest, part = graph.largest_of_part(x)
        hidden = self.own(x)
        hidden += self.pooled(largest)[part]
        hidden += graph.largest_neighbour(self.neighbour(x))
        out = gelu(normed(hidden, self.norm))
        out += x
        return out
