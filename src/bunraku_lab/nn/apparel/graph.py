"""The apparel graphs of several characters as one block of tensors, and the layer that works on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku_lab.nn.edge_conv import EdgeConv

__all__ = ["EdgeBlock", "NodeGraph", "node_graph"]


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

    Args:
        width: Channels.

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
