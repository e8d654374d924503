"""The mesh as the Mesh Handle Predictor sees it, and the graph layer that it is made of.

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

from bunraku.nn.edge_conv import EdgeConv

__all__ = [
    "GraphLayer",
    "MeshGraph",
    "farthest_points",
    "mesh_graph",
]

_NEAR = 3  # anchors that each vertex listens to


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
    ranks, number = _neighbour_ranks(np.asarray(edges, np.int64), count)
    return MeshGraph(
        inputs=torch.from_numpy(np.concatenate([positions, normals], axis=1).astype(np.float32)),
        areas=torch.from_numpy(share),
        ranks=tuple(torch.from_numpy(rank) for rank in ranks),
        position=torch.from_numpy(number),
        spread=torch.from_numpy(spread),
        gather=torch.from_numpy(np.ascontiguousarray(gather, dtype=np.float32)),
        anchors=torch.from_numpy(points),
    )


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
