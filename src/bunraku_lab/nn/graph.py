"""Meshes as graphs of tensors: edge convolution over neighbours in ranks, the graph of a whole mesh that the Mesh
Handle Predictor learns from, and the apparel graphs of several characters as one block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import nn

from bunraku.anatomy.handles.networks import anchored, area_shares, neighbour_ranks


class HasNeighbours(Protocol):
    """What an EdgeConv needs of a graph: `ranks` and `position` as `MeshGraph` has them."""

    @property
    def ranks(self) -> tuple[torch.Tensor, ...]:
        """The n-th neighbours of the vertices that have so many."""

    @property
    def position(self) -> torch.Tensor:
        """Where each vertex is in the order of the ranks."""


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
        return best.index_select(0, graph.position)

    @staticmethod
    def backward(ctx, *gradients: torch.Tensor):  # type: ignore[no-untyped-def]
        values, best = ctx.saved_tensors
        order = torch.empty_like(ctx.graph.position)
        order[ctx.graph.position] = torch.arange(len(order), device=order.device)
        gradient = gradients[0][order]
        out = torch.zeros_like(values)
        for neighbours in ctx.graph.ranks:
            count = len(neighbours)
            out.index_add_(0, neighbours, gradient[:count] * (values.index_select(0, neighbours) == best[:count]))
        return out, None


def largest_neighbour(values: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:
    """The largest of each channel among the neighbours of each vertex, shape (V, C) -> (V, C)."""
    result: torch.Tensor = _NeighbourMax.apply(values, graph)  # type: ignore[no-untyped-call]
    return result


class EdgeConv(nn.Module):
    """max over neighbours j of `W1 x_i + W2 (x_j - x_i) + b` (Wang et al. 2019), as `(W1 - W2) x_i + b + max_j W2 x_j`.

    Shapes: (V, width_in) -> (V, width_out).
    """

    def __init__(self, width_in: int, width_out: int):
        super().__init__()
        self.own = nn.Linear(width_in, width_out)
        self.neighbour = nn.Linear(width_in, width_out, bias=False)

    def forward(self, x: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:
        values = self.neighbour(x)
        return torch.as_tensor(self.own(x) - values + largest_neighbour(values, graph))


def edge_conv_reference(layer: EdgeConv, x: torch.Tensor, graph: HasNeighbours) -> torch.Tensor:
    """`EdgeConv` as its definition reads, one vertex and one edge at a time."""
    rows = []
    for vertex in range(len(x)):
        index = int(graph.position[vertex])
        neighbours = [int(rank[index]) for rank in graph.ranks if index < len(rank)]
        messages = [layer.own(x[vertex]) + layer.neighbour(x[j] - x[vertex]) for j in neighbours]
        rows.append(torch.stack(messages).amax(0))
    return torch.stack(rows)


@dataclass
class MeshGraph:
    """A mesh as tensors, its vertices as they are; fields as of `bunraku.anatomy.handles.networks.MeshGraph`, whose
    vertices are in the order that `position` tells.
    """

    inputs: torch.Tensor
    areas: torch.Tensor
    ranks: tuple[torch.Tensor, ...]
    position: torch.Tensor
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


def mesh_graph(
    positions: np.ndarray, normals: np.ndarray, edges: np.ndarray, areas: np.ndarray, anchors: int = 128,
    rng: np.random.Generator | None = None,
) -> MeshGraph:  # fmt: skip
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
    chosen, index, weight = anchored(positions, anchors, rng)
    spread = np.zeros((count, len(chosen)), np.float32)
    np.put_along_axis(spread, index, weight, axis=1)
    share = area_shares(areas)
    gather = (spread * share[:, None]).T
    gather /= np.maximum(gather.sum(axis=1, keepdims=True), 1e-20)
    ranks, number = neighbour_ranks(np.asarray(edges, np.int64), count)
    inputs = np.concatenate([positions, normals], axis=1).astype(np.float32)
    fields = (
        inputs,
        share,
        number,
        spread,
        np.ascontiguousarray(gather, np.float32),
        positions[chosen].astype(np.float32),
    )
    seen, shares, where, *more = map(torch.from_numpy, fields)
    return MeshGraph(seen, shares, tuple(map(torch.from_numpy, ranks)), where, *more)


@dataclass
class NodeGraph:
    """Neighbours and parts of M nodes of B characters.

    Args:
        ranks: Each node itself, then its n-th neighbours, shape (M,) each.
        position: Each node's own number, shape (M,).
        part: Part of each node, counted over all characters, shape (M,).
        parts: How many there are.
        owner: Character of each node, shape (M,).
        edges: Pairs of neighbours, each once, shape (E, 2).
        around: Each node itself and its neighbours, one node after the other, shape (M (K + 1),).
    """

    ranks: tuple[torch.Tensor, ...]
    position: torch.Tensor
    part: torch.Tensor
    parts: int
    owner: torch.Tensor
    edges: torch.Tensor
    around: torch.Tensor


def node_graph(neighbours: Sequence[np.ndarray], parts: Sequence[np.ndarray]) -> NodeGraph:
    """One block of the graphs of B characters.

    Args:
        neighbours: Of each character, shape (M_b, K).
        parts: Part of each node, by any numbers from 0, shape (M_b,).
    """
    rows, part, owner, start, first = [], [], [], 0, 0
    for number, (near, own) in enumerate(zip(neighbours, parts, strict=True)):
        rows.append(near + start)
        part.append(own.astype(np.int64) + first)
        owner.append(np.full(len(own), number))
        start += len(own)
        first += int(own.max(initial=-1)) + 1
    table = np.concatenate(rows)
    count = len(table)
    here = np.arange(count)
    pairs = np.stack([np.repeat(here, table.shape[1]), table.reshape(-1)], axis=1)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    index = torch.from_numpy(here)
    ranks = (index, *(torch.from_numpy(np.ascontiguousarray(column)) for column in table.T))
    return NodeGraph(
        ranks, index, torch.from_numpy(np.concatenate(part)), first, torch.from_numpy(np.concatenate(owner)),
        torch.from_numpy(pairs), torch.from_numpy(np.concatenate([here[:, None], table], axis=1).reshape(-1)),
    )  # fmt: skip


def _largest(x: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
    """The largest feature in each part, shape (M, C) -> (P, C)."""
    rows = graph.part[:, None].expand_as(x)
    return x.new_full((graph.parts, x.shape[1]), -1e4).scatter_reduce(0, rows, x, "amax")


class EdgeBlock(nn.Module):
    """An edge convolution within parts, with what the part as a whole says, added to what came in.

    Shapes: (M, width) -> (M, width).
    """

    def __init__(self, width: int):
        super().__init__()
        self.edge = EdgeConv(width, width)
        self.pooled = nn.Linear(width, width, bias=False)
        self.norm = nn.LayerNorm(width)

    def forward(self, x: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
        """Grouped edge convolution: max over neighbours of MLP(H_i, H_j - H_i) [MMDMC 13].

        The linear map runs once a node (`nn.edge_conv.EdgeConv`); neighbours are of the same part, so parts do not
        pass messages to one another.
        """
        pooled: torch.Tensor = self.pooled(_largest(x, graph))  # of the parts, which are fewer than the nodes
        hidden = self._edges(x, graph) + pooled.index_select(0, graph.part)
        out: torch.Tensor = x + nn.functional.gelu(self.norm(hidden))
        return out

    def _edges(self, x: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
        """`EdgeConv`, without what its gradient needs where there is none: all nodes have as many neighbours."""
        if torch.is_grad_enabled():
            out: torch.Tensor = self.edge(x, graph)
            return out
        values = self.edge.neighbour(x)
        most = values.index_select(0, graph.around).view(len(x), -1, values.shape[1]).amax(dim=1)
        return torch.as_tensor(self.edge.own(x) - values + most)
