"""The mesh as the Mesh Handle Predictor sees it.

A layer of the predictor has two terms. The fine one is an EdgeConv over the one-ring, decomposed so that the linear
maps run once a vertex and not once an edge. The coarse one lets every part of the mesh hear of every other: features
are gathered into at most 128 anchors, spread evenly over the surface, the anchors attend to one another, and the result
is spread back. A one-ring is a millimetre on one mesh and a limb on another; the anchors are the same on both, so the
predictor's field of view does not depend on the tessellation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["MeshGraph", "OrderedGraph", "farthest_points", "mesh_graph", "ordered_graph"]

_NEAR = 3  # anchors that each vertex listens to


@dataclass
class MeshGraph:
    """A mesh as arrays.

    Args:
        inputs: Position and normal of each vertex, shape (V, 6).
        areas: Share of the surface that each vertex stands for, shape (V,), sums to 1.
        ranks: The n-th neighbours of the vertices that have so many, vertices in order of falling degree; every vertex
            is its own first neighbour. Shapes (V,), (V_1,), (V_2,) ...
        position: Where each vertex is in that order, shape (V,).
        spread: Weights from anchors to vertices, rows sum to 1, shape (V, M).
        gather: Weights from vertices to anchors, rows sum to 1, shape (M, V).
        anchors: Positions of the anchors, shape (M, 3).
    """

    inputs: np.ndarray
    areas: np.ndarray
    ranks: tuple[np.ndarray, ...]
    position: np.ndarray
    spread: np.ndarray | csr_matrix
    gather: np.ndarray | csr_matrix
    anchors: np.ndarray

    def mirrored(self) -> MeshGraph:
        """The mirror image in the plane x = 0, with the same vertices in the same order."""
        flip = np.array([-1, 1, 1, -1, 1, 1], np.float32)
        return type(self)(**{**vars(self), "inputs": self.inputs * flip, "anchors": self.anchors * flip[:3]})

    def largest_neighbour(self, values: np.ndarray) -> np.ndarray:
        """The largest of each channel among the neighbours of each vertex, shape (V, C) -> (V, C).

        With the vertices in order of falling degree, the n-th neighbours of all vertices that have one are a prefix: no
        padding, and all work is in whole slices.
        """
        return self._largest(values, values[self.ranks[0]])[self.position]

    def _largest(self, values: np.ndarray, own: np.ndarray) -> np.ndarray:
        """The same of vertices in order of falling degree, `own` the values of these."""
        best, room = np.empty_like(values), np.empty_like(values)
        seen = own
        for neighbours in self.ranks[1:]:
            count = len(neighbours)
            other = values.take(neighbours, axis=0, out=room[:count], mode="clip")
            np.maximum(seen[:count], other, out=best[:count])
            if seen is own:
                seen, best[count:] = best, own[count:]
        return own.copy() if seen is own else best


class OrderedGraph(MeshGraph):
    """A graph whose vertices are in order of falling degree, so that no layer puts them in order: row i of what is said
    of them belongs where `position` says. What passes between them and the anchors are sparse matrices.
    """

    def largest_neighbour(self, values: np.ndarray) -> np.ndarray:
        """As `MeshGraph.largest_neighbour`."""
        return self._largest(values, values)


def farthest_points(positions: np.ndarray, count: int) -> np.ndarray:
    """Indices of points spread evenly by farthest-point sampling, starting with the point farthest from the middle."""
    x = np.ascontiguousarray(positions.T, dtype=np.float32)
    distance = ((x - x.mean(axis=1, keepdims=True)) ** 2).sum(axis=0)
    chosen = np.empty(count, np.int64)
    chosen[0] = int(distance.argmax())
    distance = np.full(len(positions), np.inf, np.float32)
    for n in range(1, count):
        gap = x - x[:, chosen[n - 1], None]
        np.minimum(distance, np.einsum("iv,iv->v", gap, gap), out=distance)
        chosen[n] = int(distance.argmax())
    return chosen


def _neighbour_ranks(edges: np.ndarray, count: int) -> tuple[list[np.ndarray], np.ndarray]:
    """`MeshGraph.ranks` and `MeshGraph.position` of undirected edges (E, 2)."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    degrees = np.bincount(both[:, 0], minlength=count)
    order = np.argsort(-degrees, kind="stable")
    index = np.empty(count, np.int64)
    index[order] = np.arange(count)
    starts = np.cumsum(degrees) - degrees
    ranks = [order]
    for n in range(int(degrees.max(initial=0))):
        rows = order[: int((degrees > n).sum())]
        ranks.append(both[starts[rows] + n, 1])
    return ranks, index


def mesh_graph(
    positions: np.ndarray,
    normals: np.ndarray,
    edges: np.ndarray,
    areas: np.ndarray,
    anchors: int = 128,
    rng: np.random.Generator | None = None,
) -> MeshGraph:
    """The graph of a normalised mesh.

    Args:
        positions: Vertices, centred, largest extent 1, shape (V, 3).
        normals: Vertex normals, shape (V, 3).
        edges: Undirected edges, each once, bridges between loose parts included, shape (E, 2).
        areas: Surface that each vertex stands for, any unit, shape (V,).
        anchors: Most anchors, M.
        rng: For training, where other anchors are to be drawn each time; without it they depend on the mesh alone.
    """
    count = len(positions)
    chosen, index, weight = _anchored(positions, anchors, rng)
    spread = np.zeros((count, len(chosen)), np.float32)
    np.put_along_axis(spread, index, weight, axis=1)
    share = _shares(areas)
    gather = (spread * share[:, None]).T
    gather /= np.maximum(gather.sum(axis=1, keepdims=True), 1e-20)
    ranks, number = _neighbour_ranks(np.asarray(edges, np.int64), count)
    return MeshGraph(
        inputs=np.concatenate([positions, normals], axis=1).astype(np.float32),
        areas=share,
        ranks=tuple(ranks),
        position=number,
        spread=spread,
        gather=np.ascontiguousarray(gather, dtype=np.float32),
        anchors=positions[chosen].astype(np.float32),
    )


def ordered_graph(
    positions: np.ndarray, normals: np.ndarray, edges: np.ndarray, areas: np.ndarray, anchors: int = 128
) -> OrderedGraph:
    """`mesh_graph` with its vertices in order of falling degree, for inference; arguments are those."""
    count = len(positions)
    chosen, index, weight = _anchored(positions, anchors)
    ranks, number = _neighbour_ranks(np.asarray(edges, np.int64), count)
    order = ranks[0]
    columns, values, share = index[order].reshape(-1), weight[order], _shares(areas)[order]
    rows = np.arange(0, len(columns) + 1, index.shape[1])
    heard = (values * share[:, None]).reshape(-1)
    heard /= np.maximum(np.bincount(columns, heard, len(chosen)), 1e-20).astype(np.float32)[columns]
    shape = count, len(chosen)
    return OrderedGraph(
        inputs=np.concatenate([positions, normals], axis=1).astype(np.float32)[order],
        areas=share,
        ranks=tuple(number[rank] for rank in ranks),
        position=number,
        spread=csr_matrix((values.reshape(-1), columns, rows), shape=shape),
        gather=csr_matrix(csr_matrix((heard, columns, rows), shape=shape).T),
        anchors=positions[chosen].astype(np.float32),
    )


def _anchored(
    positions: np.ndarray, anchors: int, rng: np.random.Generator | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which vertices are anchors, shape (M,); the anchors that each vertex listens to, shape (V, n), and how much."""
    seen = positions if rng is None else positions + rng.normal(0, 0.02, positions.shape)
    chosen = farthest_points(seen, min(anchors, len(positions)))
    points = positions[chosen].astype(np.float32)
    squared = ((positions**2).sum(axis=1)[:, None] - 2 * positions @ points.T + (points**2).sum(axis=1)).astype(
        np.float32
    )
    near = min(_NEAR, len(chosen))
    index = np.argpartition(squared, near - 1, axis=1)[:, :near]
    weight = 1 / (np.maximum(np.take_along_axis(squared, index, axis=1), 0) + 1e-4)
    return chosen, index, (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)


def _shares(areas: np.ndarray) -> np.ndarray:
    """Share of the surface that each vertex stands for, shape (V,), not 0."""
    share = np.maximum(np.asarray(areas, np.float64), 0)
    share = (share + 1e-3 * max(share.mean(), 1e-12)).astype(np.float32)
    return np.asarray(share / share.sum())
