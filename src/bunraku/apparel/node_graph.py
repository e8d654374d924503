"""The points or nodes that the networks of apparel work on, with their neighbours and parts, and a layer on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bunraku.nn.layers import Linear, Norm, gelu, normed
from bunraku.nn.weights import Weights

__all__ = ["EdgeBlock", "NodeGraph"]

LEAST = np.float32(-1e4)
"""Below any feature: what a part without points says."""


@dataclass(frozen=True, eq=False)
class NodeGraph:
    """Neighbours and parts of M points of one mesh.

    Args:
        neighbours: Shape (M, K).
        part: Part of each, by any numbers from 0, shape (M,).
    """

    neighbours: np.ndarray
    part: np.ndarray

    @cached_property
    def _runs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points in the order of their parts, where each part begins in it, and which of these each point is of."""
        order = np.argsort(self.part, kind="stable")
        _, starts, own = np.unique(self.part[order], return_index=True, return_inverse=True)
        number = np.empty(len(order), np.int64)
        number[order] = own
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
        """The largest of each channel in each part that has points, shape (P, C), and the row of each point, shape
        (M,).
        """
        order, starts, number = self._runs
        return np.maximum(np.maximum.reduceat(values[order], starts, axis=0), LEAST), number


class EdgeBlock:
    """An edge convolution within parts, with what the part as a whole says, added to what came in (Eq. 13 of MMDMC).

    The convolution is (W1 - W2) x_i + b + max_j W2 x_j, whose two maps of the point itself are one.

    Args:
        width: Channels.
        weights: Of the layer.
    """

    def __init__(self, width: int, weights: Weights):
        own = weights.linear("edge.own", width, width)
        self.neighbour: Linear = weights.linear("edge.neighbour", width, width, bias=False)
        self.own = Linear(own.matrix - self.neighbour.matrix, own.bias)
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
