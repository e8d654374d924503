"""The skinning network of Neural Blend Shapes (Li et al., SIGGRAPH 2021) for a given skeleton, with the convolution on
edges that it uses (MeshCNN, Hanocka et al. 2019) and linear blend skinning in torch. Its blend shapes are left out,
which made it no better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.core.body.layout import JOINT_COUNT
from bunraku_lab.nn.checkpoints import SavedNetwork

SLOPE = 0.2
"""Of the LeakyReLU. As in the published code of the method."""
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
        edges: All edges of the faces, and others in no triangle, each once, smaller vertex first, shape (E, 2).
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


def moved_by(rest: torch.Tensor, weights: torch.Tensor, affine: torch.Tensor) -> torch.Tensor:
    """Linear blend skinning, shape (P, V, 3).

    Args:
        rest: The rest pose, shape (V, 3).
        weights: Shape (V, J).
        affine: Affine transforms of the joints, shape (P, J, 3, 4).
    """
    blended = torch.einsum("vj,pjab->pvab", weights, affine)
    return (blended[..., :3] @ rest.expand(len(affine), -1, -1)[..., None])[..., 0] + blended[..., 3]


KIND = "nbs"


@dataclass(frozen=True)
class NbsConfig:
    """Shape of the network.

    Args:
        skinning: Channels of the skinning branch.
    """

    skinning: tuple[int, ...] = (64, 128, 256)


class _Branch(nn.Module):
    """Mesh convolutions, with activations between them."""

    def __init__(self, *widths: int):
        super().__init__()
        pairs = zip(widths, widths[1:], strict=False)
        self.layers = nn.ModuleList(MeshConv(before, after) for before, after in pairs)

    def forward(self, x: torch.Tensor, mesh: EdgeMesh) -> torch.Tensor:
        for number, layer in enumerate(self.layers):
            x = layer(hinted(x) if number else x, mesh)
        return x


class NbsNetwork(SavedNetwork):
    """The network."""

    kind = KIND
    shape = NbsConfig

    def __init__(self, config: NbsConfig | None = None):
        super().__init__()
        self.config = config = config or NbsConfig()
        self.skinning = _Branch(3, *config.skinning, JOINT_COUNT)

    def forward(self, points: torch.Tensor, mesh: EdgeMesh) -> torch.Tensor:
        """Skinning weights of the joints, shape (V, J), rows sum to 1.

        Args:
            points: Vertices over the height, feet at 0, x and z from the pelvis, shape (V, 3).
            mesh: Their edges.
        """
        return vertex_means(self.skinning(points[mesh.ends].mean(dim=1), mesh), mesh).softmax(dim=1)
