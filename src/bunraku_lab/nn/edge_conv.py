"""Edge convolution over a graph whose neighbours are in ranks."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import nn

__all__ = ["EdgeConv", "HasNeighbours", "edge_conv_reference"]


class HasNeighbours(Protocol):
    """What an EdgeConv needs of a graph: `ranks` and `position` as `handles.inference.graph.MeshGraph` has them."""

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
        index = int(graph.position[vertex])
        neighbours = [int(rank[index]) for rank in graph.ranks if index < len(rank)]
        messages = [layer.own(x[vertex]) + layer.neighbour(x[j] - x[vertex]) for j in neighbours]
        rows.append(torch.stack(messages).amax(0))
    return torch.stack(rows)
