"""The networks of Neural Blend Shapes (Li et al., SIGGRAPH 2021) for a given skeleton, with the convolution on edges
that they use (MeshCNN, Hanocka et al. 2019) and linear blend skinning in torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku_lab.nn.checkpoints import SavedNetwork

__all__ = [
    "BlendShapes", "EdgeMesh", "MeshConv", "NbsConfig", "NbsNetwork", "edge_mesh", "hinted", "local_rotations",
    "moved_by", "vertex_means",
]  # fmt: skip

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
        rest: One rest pose for all, shape (V, 3), or one for each pose, shape (P, V, 3).
        weights: Shape (V, J).
        affine: Affine transforms of the joints, shape (P, J, 3, 4).
    """
    blended = torch.einsum("vj,pjab->pvab", weights, affine)
    return (blended[..., :3] @ rest.expand(len(affine), -1, -1)[..., None])[..., 0] + blended[..., 3]


KIND = "nbs"
NEAR, NEAR_WRIST = 0.05, 0.02
"""Weights to a joint or the joint above from which a vertex takes the joint's shapes. As in the published code of the
method.
"""
QUIET = 1 / 1000
"""Of the last layer of coefficients before it has learned."""


@dataclass(frozen=True)
class NbsConfig:
    """Shape of the networks.

    Args:
        skinning: Channels of the skinning branch.
        geometry: Channels of the geometry branch.
        mixed: Channels between geometry and blend shapes.
        shapes: Blend shapes of a vertex; 0 leaves the branch out.
    """

    skinning: tuple[int, ...] = (64, 128, 256)
    geometry: tuple[int, ...] = (64, 128, 256, 512)
    mixed: int = 256
    shapes: int = 0


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


class BlendShapes(nn.Module):
    """Shapes of each vertex from geometry and skinning, and their coefficients from how each joint turns."""

    def __init__(self, config: NbsConfig):
        super().__init__()
        count = config.shapes
        self.geometry = _Branch(3, *config.geometry)
        self.shapes = _Branch(config.geometry[-1] + JOINT_COUNT, config.mixed, 3 * count)
        self.coefficients = nn.ModuleList(
            nn.Sequential(
                nn.Linear(9, 18), nn.LeakyReLU(0.2), nn.Linear(18, 32), nn.LeakyReLU(0.2), nn.Linear(32, count)
            )
            for _ in range(JOINT_COUNT)
        )
        with torch.no_grad():
            for each in self.coefficients:
                each[-1].weight.mul_(QUIET)  # type: ignore[index, operator, union-attr]
                each[-1].bias.mul_(QUIET)  # type: ignore[index, operator, union-attr]

    def forward(
        self, middles: torch.Tensor, logits: torch.Tensor, weights: torch.Tensor, mesh: EdgeMesh
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Shapes of each vertex, (V, S, 3), and which joints' shapes it takes, (V, J).

        Args:
            middles: Midpoints of the edges, shape (E, 3).
            logits: What the skinning branch says of the edges, shape (E, J).
            weights: Of the vertices, shape (V, J).
            mesh: The edges.
        """
        geometry = hinted(self.geometry(middles, mesh))
        edges = self.shapes(torch.cat([geometry, logits.softmax(dim=1)], dim=1), mesh)
        return vertex_means(edges, mesh).unflatten(1, (-1, 3)), shape_joints(weights)

    def moved(self, shapes: torch.Tensor, takes: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
        """What the shapes add to the rest pose, shape (P, V, 3).

        Args:
            shapes, takes: As `forward` gives them.
            turns: Of each joint to its parent, shape (P, J, 3, 3).
        """
        away = (turns - torch.eye(3, device=turns.device)).flatten(2)
        each = torch.stack([net(away[:, joint]) for joint, net in enumerate(self.coefficients)], dim=1)
        return torch.einsum("vj,pjs,vsa->pva", takes, each, shapes)


class NbsNetwork(SavedNetwork):
    """The network."""

    kind = KIND
    shape = NbsConfig

    def __init__(self, config: NbsConfig | None = None):
        super().__init__()
        self.config = config = config or NbsConfig()
        self.skinning = _Branch(3, *config.skinning, JOINT_COUNT)
        self.blend = BlendShapes(config) if config.shapes else None

    def forward(self, points: torch.Tensor, mesh: EdgeMesh) -> torch.Tensor:
        """Skinning weights of the joints, shape (V, J), rows sum to 1.

        Args:
            points: Vertices over the height, feet at 0, x and z from the pelvis, shape (V, 3).
            mesh: Their edges.
        """
        return self.skinned(points, mesh)[0]

    def skinned(self, points: torch.Tensor, mesh: EdgeMesh) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """As `forward`, with what the branch says of the edges and their midpoints."""
        middles = points[mesh.ends].mean(dim=1)
        logits = self.skinning(middles, mesh)
        return vertex_means(logits, mesh).softmax(dim=1), logits, middles


def shape_joints(weights: torch.Tensor) -> torch.Tensor:
    """Which joints' shapes each vertex takes, 1 or 0: of those that it or the joint above holds, shape (V, J)."""
    least = weights.new_tensor([NEAR_WRIST if "wrist" in name else NEAR for name in JOINT_NAMES])
    above = [max(parent, 0) for parent in JOINT_PARENTS]
    held = torch.maximum(weights, weights[:, above])
    return (held > least).to(weights.dtype)


def local_rotations(turns: torch.Tensor) -> torch.Tensor:
    """Rotations relative to the parents, from rotations in the world, both (P, J, 3, 3); the root's is the identity."""
    above = [max(parent, 0) for parent in JOINT_PARENTS]
    return turns[:, above].transpose(2, 3) @ turns
