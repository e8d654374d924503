"""The edges of a mesh as a MeshCNN sees them (Hanocka et al. 2019), and the convolution on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

__all__ = ["EdgeMesh", "MeshConv", "edge_mesh", "hinted", "vertex_means"]

SLOPE = 0.2
"""Of the LeakyReLU."""
HINT = 5
"""One in so many channels, the first ones, says the largest value over the whole mesh."""


@dataclass(frozen=True, eq=False)
class EdgeMesh:
    """The edges of a mesh.

    Args:
        ends: Vertices of each edge, shape (E, 2).
        around: The other edges a, b of its first triangle and c, d of its second, each pair in the order in which the
            triangle goes on from the edge; E where there is none, shape (E, 4).
        count: Number of vertices V.
    """

    ends: torch.Tensor
    around: torch.Tensor
    count: int


def edge_mesh(faces: np.ndarray, edges: np.ndarray, count: int) -> EdgeMesh:
    """The edges of a mesh, each with the edges of at most two of its triangles.

    Args:
        faces: Vertex indices, shape (F, 3).
        edges: All edges of the faces, and others that lie in no triangle, each once, smaller vertex first, shape (E,
            2).
        count: Number of vertices.
    """
    key = edges[:, 0] * count + edges[:, 1]
    order = np.argsort(key)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)  # from each corner to the next, (F, 3, 2)
    pair = np.sort(sides, axis=2)
    own = order[np.searchsorted(key[order], pair[..., 0] * count + pair[..., 1])]
    following = np.stack([np.roll(own, -1, axis=1), np.roll(own, -2, axis=1)], axis=2).reshape(-1, 2)
    flat = own.reshape(-1)
    by_edge = np.argsort(flat, kind="stable")
    rank = np.arange(len(flat)) - np.searchsorted(flat[by_edge], flat[by_edge])
    around = np.full((len(edges), 2, 2), len(edges))
    for number in (0, 1):
        rows = by_edge[rank == number]
        around[flat[rows], number] = following[rows]
    return EdgeMesh(torch.from_numpy(np.asarray(edges, np.int64)), torch.from_numpy(around.reshape(-1, 4)), count)


class MeshConv(nn.Module):
    """A linear map of `[e, a + c, b + d, |a - c|, |b - d|]`, which does not depend on which triangle comes first.

    Args:
        width_in, width_out: Channels.

    Shapes: (E, width_in) -> (E, width_out).
    """

    def __init__(self, width_in: int, width_out: int):
        super().__init__()
        self.linear = nn.Linear(5 * width_in, width_out)

    def forward(self, x: torch.Tensor, mesh: EdgeMesh) -> torch.Tensor:
        padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
        a, b, c, d = (padded.index_select(0, column) for column in mesh.around.T)
        out: torch.Tensor = self.linear(torch.cat([x, a + c, b + d, (a - c).abs(), (b - d).abs()], dim=1))
        return out


def hinted(x: torch.Tensor) -> torch.Tensor:
    """LeakyReLU, then the first fifth of the channels replaced by their largest value over the mesh, shape (E, C)."""
    x = nn.functional.leaky_relu(x, SLOPE)
    few = x.shape[1] // HINT
    return torch.cat([x[:, :few].amax(dim=0, keepdim=True).expand(len(x), few), x[:, few:]], dim=1)


def vertex_means(x: torch.Tensor, mesh: EdgeMesh) -> torch.Tensor:
    """The mean over the edges of each vertex, shape (E, C) -> (V, C); 0 where there are none."""
    ends = mesh.ends.reshape(-1)
    total = x.new_zeros(mesh.count, x.shape[1]).index_add_(0, ends, x.repeat_interleave(2, dim=0))
    degree = torch.bincount(ends, minlength=mesh.count).clamp(min=1)
    return total / degree[:, None]
