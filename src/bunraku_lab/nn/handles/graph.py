"""The mesh as the Mesh Handle Predictor learns from it, and the graph layer that it is made of.

A layer has two terms. The fine one is an EdgeConv over the one-ring, decomposed so that the linear maps run once a
vertex and not once an edge. The coarse one lets every part of the mesh hear of every other: features are gathered into
at most 128 anchors, spread evenly over the surface, the anchors attend to one another, and the result is spread back. A
one-ring is a millimetre on one mesh and a limb on another; the anchors are the same on both, so the predictor's field
of view does not depend on the tessellation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.handles.inference import graph as arrays
from bunraku_lab.nn.edge_conv import EdgeConv

__all__ = ["AnchorBlock", "GraphLayer", "MeshGraph", "mesh_graph"]


@dataclass
class MeshGraph:
    """A mesh as tensors.

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
    found = vars(arrays.mesh_graph(positions, normals, edges, areas, anchors, rng))
    ranks = tuple(torch.from_numpy(rank) for rank in found.pop("ranks"))
    return MeshGraph(**{name: torch.from_numpy(value) for name, value in found.items()}, ranks=ranks)


class AnchorBlock(nn.Module):
    """One round in which the anchors pass messages to one another: attention, then an MLP, each added to what was
    there.

    Args:
        width: Channels.
        heads: Attention heads.
        quiet: Start without effect, so that a deeper network begins as the shallower one it grew from.

    Shapes: (M, width) -> (M, width).
    """

    def __init__(self, width: int, heads: int, quiet: bool = False):
        super().__init__()
        if heads < 1 or width % heads:
            raise ValueError(f"{width} channels cannot be shared by {heads} heads")
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
