"""The apparel graphs of several characters as one block of tensors, and the layer that works on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.handles.graph import EdgeConv

__all__ = ["EdgeBlock", "NodeGraph", "node_graph", "part_pool"]


@dataclass
class NodeGraph:
    """Neighbours and parts of M nodes of B characters.

    Args:
        ranks: Each node itself, then its n-th neighbours, shape (M,) each.
        place: Each node's own number, shape (M,).
        part: Part of each node, counted over all characters, shape (M,).
        parts: How many there are.
        owner: Character of each node, shape (M,).
        edges: Pairs of neighbours, each once, shape (E, 2).
    """

    ranks: tuple[torch.Tensor, ...]
    place: torch.Tensor
    part: torch.Tensor
    parts: int
    owner: torch.Tensor
    edges: torch.Tensor


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
    place = torch.from_numpy(here)
    ranks = (place, *(torch.from_numpy(np.ascontiguousarray(column)) for column in table.T))
    return NodeGraph(
        ranks, place, torch.from_numpy(np.concatenate(part)), first, torch.from_numpy(np.concatenate(owner)),
        torch.from_numpy(pairs),
    )  # fmt: skip


def part_pool(x: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
    """The largest feature in the part of each node, shape (M, C) -> (M, C): what a node hears of its part beyond its
    neighbours, and nothing of other parts.
    """
    rows = graph.part[:, None].expand_as(x)
    pooled = x.new_full((graph.parts, x.shape[1]), -1e4).scatter_reduce(0, rows, x, "amax")
    return pooled[graph.part]


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

        The linear map runs once a node (`handles.graph.EdgeConv`); neighbours are of the same part, so parts do not
        hear of one another.
        """
        heard = self.edge(x, graph) + self.pooled(part_pool(x, graph))
        out: torch.Tensor = x + nn.functional.gelu(self.norm(heard))
        return out
