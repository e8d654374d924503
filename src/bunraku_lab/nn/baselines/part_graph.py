"""Meshes as one-ring graphs, several in one block, and the convolution of Skeleton-free Pose Transfer on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

__all__ = ["GraphUnit", "PartGraph", "dense", "part_graph", "per_mesh_max", "shares_of"]

MOMENTUM = 0.1


@dataclass(frozen=True, eq=False)
class PartGraph:
    """B meshes with N vertices together.

    Args:
        inputs: Position and normal, shape (N, 6).
        into: Vertex that hears of another, shape (E,); each hears of itself.
        out_of: The other, shape (E,).
        sizes: Vertices of each mesh.
    """

    inputs: torch.Tensor
    into: torch.Tensor
    out_of: torch.Tensor
    sizes: tuple[int, ...]

    def to(self, device: torch.device | str) -> PartGraph:
        """The same graph on another device."""
        return PartGraph(self.inputs.to(device), self.into.to(device), self.out_of.to(device), self.sizes)


def part_graph(meshes: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> PartGraph:
    """A block of meshes.

    Args:
        meshes: Of each the vertices (M, 3), the normals (M, 3), and the edges, each once (E, 2).
    """
    into, out_of, start = [], [], 0
    for points, _, edges in meshes:
        own = np.arange(len(points))
        into.append(start + np.concatenate([own, edges[:, 0], edges[:, 1]]))
        out_of.append(start + np.concatenate([own, edges[:, 1], edges[:, 0]]))
        start += len(points)
    inputs = np.concatenate([np.concatenate([points, normals], axis=1) for points, normals, _ in meshes])
    return PartGraph(
        torch.from_numpy(np.asarray(inputs, np.float32)), torch.from_numpy(np.concatenate(into)),
        torch.from_numpy(np.concatenate(out_of)), tuple(len(points) for points, *_ in meshes),
    )  # fmt: skip


class Norm(nn.Module):
    """BatchNorm whose running means follow each batch with a tenth, shape (N, C); its state is four vectors."""

    running_mean: torch.Tensor
    running_var: torch.Tensor

    def __init__(self, width: int):
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))
        self.register_buffer("running_mean", torch.zeros(width))
        self.register_buffer("running_var", torch.ones(width))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return nn.functional.batch_norm(
            x, self.running_mean, self.running_var, self.weight, self.bias, self.training, MOMENTUM
        )


def dense(*widths: int) -> nn.Sequential:
    """Linear layers, each with ReLU and then BatchNorm."""
    parts: list[nn.Module] = []
    for before, after in zip(widths, widths[1:], strict=False):
        parts += [nn.Linear(before, after), nn.ReLU(), Norm(after)]
    return nn.Sequential(*parts)


class GraphUnit(nn.Module):
    """GCU: the largest message MLP([x_i, x_j - x_i]) over the one-ring and the vertex itself, then an MLP; each linear
    layer with ReLU and BatchNorm.

    The first linear map runs once a vertex: A x_i + B (x_j - x_i) is (A - B) x_i + B x_j.

    Args:
        width_in, width_out: Channels.

    Shapes: (N, width_in) -> (N, width_out).
    """

    def __init__(self, width_in: int, width_out: int):
        super().__init__()
        self.own = nn.Linear(width_in, width_out)
        self.other = nn.Linear(width_in, width_out, bias=False)
        self.norm = Norm(width_out)
        self.message = dense(width_out, width_out)
        self.after = dense(width_out, width_out)

    def forward(self, x: torch.Tensor, graph: PartGraph) -> torch.Tensor:
        other = self.other(x)
        here = self.own(x) - other
        first = self.norm(torch.relu(here.index_select(0, graph.into) + other.index_select(0, graph.out_of)))
        message = self.message(first)
        rows = graph.into[:, None].expand_as(message)
        most = message.new_full(x.shape[:1] + message.shape[1:], -torch.inf).scatter_reduce(0, rows, message, "amax")
        out: torch.Tensor = self.after(most)
        return out


def per_mesh_max(x: torch.Tensor, sizes: Sequence[int]) -> torch.Tensor:
    """The largest features of each mesh at each of its vertices, shape (N, C)."""
    parts = [part.amax(dim=0, keepdim=True).expand_as(part) for part in x.split(list(sizes))]
    return torch.cat(parts)


def shares_of(weights: torch.Tensor, sizes: Sequence[int]) -> list[torch.Tensor]:
    """Column-normalised weights of each mesh, (M, K) each; a part without weight keeps none."""
    return [part / part.sum(dim=0).clamp(min=1e-6) for part in weights.split(list(sizes))]
