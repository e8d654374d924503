"""The mesh as the Mesh Handle Predictor sees it, and the graph layer that it is made of.

A layer has two terms. The fine one is an EdgeConv over the one-ring, decomposed so that the linear maps run once a
vertex and not once an edge. The coarse one lets every part of the mesh hear of every other: features are gathered into
at most 128 anchors, spread evenly over the surface, the anchors attend to one another, and the result is spread back. A
one-ring is a millimetre on one mesh and a limb on another; the anchors are the same on both, so the predictor's field
of view does not depend on the tessellation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import nn

__all__ = [
    "EdgeConv",
    "GraphLayer",
    "HasNeighbours",
    "MeshGraph",
    "edge_conv_reference",
    "farthest_points",
    "mesh_graph",
]

_NEAR = 3  # anchors that each vertex listens to


class HasNeighbours(Protocol):
    """What an EdgeConv needs of a graph: `ranks` and `place` as `MeshGraph` has them."""

    @property
    def ranks(self) -> tuple[torch.Tensor, ...]:
        """The n-th neighbours of the vertices that have so many."""

    @property
    def place(self) -> torch.Tensor:
        """Where each vertex is in the order of the ranks."""


@dataclass
class MeshGraph:
    """A mesh as tensors.

    Args:
        inputs: Position and normal of each vertex, shape (V, 6).
        areas: Share of the surface that each vertex stands for, shape (V,), sums to 1.
        ranks: The n-th neighbours of the vertices that have so many, vertices in order of falling degree; every vertex
            is its own first neighbour. Shapes (V,), (V_1,), (V_2,) ...
        place: Where each vertex is in that order, shape (V,).
        spread: Weights from anchors to vertices, rows sum to 1, shape (V, M).
        gather: Weights from vertices to anchors, rows sum to 1, shape (M, V).
        anchors: Positions of the anchors, shape (M, 3).
    """

    inputs: torch.Tensor
    areas: torch.Tensor
    ranks: tuple[torch.Tensor, ...]
    place: torch.Tensor
    spread: torch.Tensor
    gather: torch.Tensor
    anchors: torch.Tensor

    def to(self, device: torch.device | str) -> MeshGraph:
        """The same graph on another device."""
        moved = {name: value.to(device) for name, value in vars(self).items() if name != "ranks"}
        return MeshGraph(**moved, ranks=tuple(rank.to(device) for rank in self.ranks))

    def mirrored(self) -> MeshGraph:
        """The mirror image in the plane x = 0, with the same vertices in the same order."""
        flip = self.inputs.new_tensor([-1.0, 1, 1, -1, 1, 1])
        return MeshGraph(**{**vars(self), "inputs": self.inputs * flip, "anchors": self.anchors * flip[:3]})


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
    """`MeshGraph.ranks` and `MeshGraph.place` of undirected edges (E, 2)."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    degrees = np.bincount(both[:, 0], minlength=count)
    order = np.argsort(-degrees, kind="stable")
    place = np.empty(count, np.int64)
    place[order] = np.arange(count)
    starts = np.cumsum(degrees) - degrees
    ranks = [order]
    for n in range(int(degrees.max(initial=0))):
        rows = order[: int((degrees > n).sum())]
        ranks.append(both[starts[rows] + n, 1])
    return ranks, place


def mesh_graph(
    positions: np.ndarray,
    normals: np.ndarray,
    edges: np.ndarray,
    areas: np.ndarray,
    anchors: int = 128,
    rng: np.random.Generator | None = None,
) -> MeshGraph:
    """Tensors of a normalised mesh.

    Args:
        positions: Vertices, centred, largest extent 1, shape (V, 3).
        normals: Vertex normals, shape (V, 3).
        edges: Undirected edges, each once, bridges between loose parts included, shape (E, 2).
        areas: Surface that each vertex stands for, any unit, shape (V,).
        anchors: Most anchors, M.
        rng: For training, where other anchors are to be drawn each time; without it they depend on the mesh alone.
    """
    count = len(positions)
    seen = positions if rng is None else positions + rng.normal(0, 0.02, positions.shape)
    chosen = farthest_points(seen, min(anchors, count))
    points = positions[chosen].astype(np.float32)
    squared = ((positions**2).sum(axis=1)[:, None] - 2 * positions @ points.T + (points**2).sum(axis=1)).astype(
        np.float32
    )
    near = min(_NEAR, len(chosen))
    index = np.argpartition(squared, near - 1, axis=1)[:, :near]
    weight = 1 / (np.maximum(np.take_along_axis(squared, index, axis=1), 0) + 1e-4)
    spread = np.zeros((count, len(chosen)), np.float32)
    np.put_along_axis(spread, index, weight / weight.sum(axis=1, keepdims=True), axis=1)
    share = np.maximum(np.asarray(areas, np.float64), 0)
    share = (share + 1e-3 * max(share.mean(), 1e-12)).astype(np.float32)
    share /= share.sum()
    gather = (spread * share[:, None]).T
    gather /= np.maximum(gather.sum(axis=1, keepdims=True), 1e-20)
    ranks, place = _neighbour_ranks(np.asarray(edges, np.int64), count)
    return MeshGraph(
        inputs=torch.from_numpy(np.concatenate([positions, normals], axis=1).astype(np.float32)),
        areas=torch.from_numpy(share),
        ranks=tuple(torch.from_numpy(rank) for rank in ranks),
        place=torch.from_numpy(place),
        spread=torch.from_numpy(spread),
        gather=torch.from_numpy(np.ascontiguousarray(gather, dtype=np.float32)),
        anchors=torch.from_numpy(points),
    )


class _NeighbourMax(torch.autograd.Function):
    """Largest feature among the neighbours of each vertex; the gradient goes to the neighbours that have it.

    With the vertices in order of falling degree, the n-th neighbours of all vertices that have one are a prefix: no
    padding, and all work is in whole slices.
    """

    @staticmethod
    def forward(ctx, values: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:  # type: ignore[no-untyped-def]
        best = values.index_select(0, graph.ranks[0])  # a third of the time of `values[...]`
        for neighbours in graph.ranks[1:]:
            part = best[: len(neighbours)]
            torch.maximum(part, values.index_select(0, neighbours), out=part)
        ctx.graph = graph
        ctx.save_for_backward(values, best)
        return best.index_select(0, graph.place)

    @staticmethod
    def backward(ctx, *gradients: torch.Tensor):  # type: ignore[no-untyped-def]
        values, best = ctx.saved_tensors
        order = torch.empty_like(ctx.graph.place)
        order[ctx.graph.place] = torch.arange(len(order), device=order.device)
        gradient = gradients[0][order]
        out = torch.zeros_like(values)
        for neighbours in ctx.graph.ranks:
            count = len(neighbours)
            out.index_add_(0, neighbours, gradient[:count] * (values.index_select(0, neighbours) == best[:count]))
        return out, None


class EdgeConv(nn.Module):
    """max over neighbours j of `W1 x_i + W2 (x_j - x_i) + b` (Wang et al. 2019), as `(W1 - W2) x_i + b + max_j W2 x_j`.

    Args:
        width_in, width_out: Channels.

    Shapes: (V, width_in) -> (V, width_out).
    """

    def __init__(self, width_in: int, width_out: int):
        super().__init__()
        self.own = nn.Linear(width_in, width_out)
        self.neighbour = nn.Linear(width_in, width_out, bias=False)

    def forward(self, x: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:
        values = self.neighbour(x)
        result: torch.Tensor = self.own(x) - values + _NeighbourMax.apply(values, graph)  # type: ignore[no-untyped-call]
        return result


def edge_conv_reference(layer: EdgeConv, x: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:
    """`EdgeConv` as its definition reads, one vertex and one edge at a time."""
    rows = []
    for vertex in range(len(x)):
        place = int(graph.place[vertex])
        neighbours = [int(rank[place]) for rank in graph.ranks if place < len(rank)]
        messages = [layer.own(x[vertex]) + layer.neighbour(x[j] - x[vertex]) for j in neighbours]
        rows.append(torch.stack(messages).amax(0))
    return torch.stack(rows)


class AnchorBlock(nn.Module):
    """One round in which the anchors hear of one another: attention, then an MLP, each added to what was there.

    Args:
        width: Channels.
        heads: Attention heads.
        quiet: Start without effect, so that a deeper network begins as the shallower one it grew from.

    Shapes: (M, width) -> (M, width).
    """

    def __init__(self, width: int, heads: int, quiet: bool = False):
        super().__init__()
        self.heads = heads
        self.norm_attention = nn.LayerNorm(width)
        self.attention = nn.Linear(width, 3 * width)
        self.merge = nn.Linear(width, width)
        self.norm_mix = nn.LayerNorm(width)
        last = nn.Linear(2 * width, width)
        self.mix = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), last)
        if quiet:
            for layer in (self.merge, last):
                nn.init.zeros_(layer.weight)
                nn.init.zeros_(layer.bias)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        count, width = tokens.shape
        q, k, v = (
            self.attention(self.norm_attention(tokens))
            .reshape(count, 3, self.heads, width // self.heads)
            .permute(1, 2, 0, 3)
        )
        mixed = nn.functional.scaled_dot_product_attention(q[None], k[None], v[None])[0]
        tokens = tokens + self.merge(mixed.transpose(0, 1).reshape(count, width))
        result: torch.Tensor = tokens + self.mix(self.norm_mix(tokens))
        return result


class GraphLayer(nn.Module):
    """`LayerNorm(EdgeConv(x) + spread(blocks(gather(x))))`, then GELU.

    Args:
        width_in, width_out: Channels.
        heads: Attention heads among the anchors.
        depth: Rounds among the anchors.

    Shapes: (V, width_in) -> (V, width_out).
    """

    def __init__(self, width_in: int, width_out: int, heads: int = 4, depth: int = 1):
        super().__init__()
        self.fine = EdgeConv(width_in, width_out)
        self.enter = nn.Linear(width_in + 3, width_out)
        self.blocks = nn.ModuleList(AnchorBlock(width_out, heads, quiet=n > 0) for n in range(depth))
        self.norm = nn.LayerNorm(width_out)

    def coarse(self, x: torch.Tensor, graph: MeshGraph) -> torch.Tensor:
        """Features of the anchors after they have attended to one another, shape (M, width_out)."""
        tokens: torch.Tensor = self.enter(torch.cat([graph.gather @ x.float(), graph.anchors], dim=-1))
        for block in self.blocks:
            tokens = block(tokens)
        return tokens

    def forward(self, x: torch.Tensor, graph: MeshGraph) -> torch.Tensor:
        both = self.fine(x, graph) + graph.spread @ self.coarse(x, graph).float()
        result: torch.Tensor = nn.functional.gelu(self.norm(both))
        return result
