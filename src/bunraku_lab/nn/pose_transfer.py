"""The networks of Skeleton-free Pose Transfer (Liao et al., ECCV 2022): one-ring graphs of several meshes in one block,
the convolution on them, and the parts of a mesh with their codes of pose and shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from bunraku.core.geometry.rotations import matrix_from_quaternion
from bunraku_lab.nn.checkpoints import SavedNetwork

# Of the batch norms, as in the published code of the method.
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


KIND = "transfer"


@dataclass(frozen=True)
class TransferConfig:
    """Shape of the networks.

    Args:
        parts: K.
        levels: Channels of the graph units.
        code: Channels of a part's code.
        correction: Whether the decoder says how a target's part differs from the source's own, which it begins as; the
            paper's says the whole transform.
    """

    parts: int = 30
    levels: tuple[int, ...] = (64, 128, 256)
    code: int = 128
    correction: bool = True


class _Levels(nn.Module):
    """Graph units in a row, their outputs joined."""

    def __init__(self, levels: tuple[int, ...]):
        super().__init__()
        widths = (6, *levels)
        self.units = nn.ModuleList(GraphUnit(a, b) for a, b in zip(widths, widths[1:], strict=False))

    def forward(self, graph: PartGraph) -> torch.Tensor:
        x, found = graph.inputs, []
        for unit in self.units:
            x = unit(x, graph)
            found.append(x)
        return torch.cat(found, dim=1)


class PartEncoder(nn.Module):
    """A code for each part of each mesh, from its vertices and the whole mesh, shape (B, K, C)."""

    def __init__(self, config: TransferConfig):
        super().__init__()
        wide = sum(config.levels)
        self.levels = _Levels(config.levels)
        self.local, self.whole = dense(wide, 256), dense(wide, 256)
        self.code = dense(512, config.code)

    def forward(self, graph: PartGraph, weights: torch.Tensor) -> torch.Tensor:
        x = self.levels(graph)
        both = torch.cat([self.local(x), per_mesh_max(self.whole(x), graph.sizes)], dim=1)
        pairs = zip(shares_of(weights, graph.sizes), both.split(list(graph.sizes)), strict=True)
        parts = torch.stack([shares.T @ own for shares, own in pairs])
        out: torch.Tensor = self.code(parts.flatten(0, 1))
        return out.unflatten(0, parts.shape[:2])


class TransferNetwork(SavedNetwork):
    """The network: one encoder for shape and pose, and a decoder. The parts are those of the Mesh Handle Predictor.

    Args:
        config: Its shape.
    """

    kind = KIND
    shape = TransferConfig

    def __init__(self, config: TransferConfig | None = None):
        super().__init__()
        self.config = config = config or TransferConfig()
        self.encoder = PartEncoder(config)
        last = nn.Linear(128, 7)
        if config.correction:
            with torch.no_grad():
                last.weight.mul_(0.01)
                last.bias.zero_()
        self.decoder = nn.Sequential(
            nn.Linear(2 * config.code + 7, 256), nn.ReLU(), nn.Linear(256, 128), nn.ReLU(), nn.Linear(128, 128),
            nn.ReLU(), last,
        )  # fmt: skip

    def forward(
        self, rest: PartGraph, posed: PartGraph, target: PartGraph, weights: tuple[torch.Tensor, torch.Tensor],
        own: torch.Tensor,
    ) -> torch.Tensor:  # fmt: skip
        """Transforms of the target's parts, shape (B, K, 7).

        Args:
            rest: The source at rest, one mesh for all poses or one for each.
            posed: The source in B poses.
            target: One mesh for all poses or one for each.
            weights: Of the parts of `rest` and of `target`, shape (N, K) each.
            own: Transforms of the source's parts, shape (B, K, 7).
        """
        pose, shape = self.pose_codes(rest, posed, weights[0]), self.encoder(target, weights[1])
        return self.decoded(pose, shape.expand_as(pose), own)

    def pose_codes(self, rest: PartGraph, posed: PartGraph, weights: torch.Tensor) -> torch.Tensor:
        """Codes of the source in its poses less those at rest, shape (B, K, C); see `forward`."""
        count = len(posed.sizes)
        moving = weights if len(rest.sizes) == count else weights.repeat(count, 1)
        out: torch.Tensor = self.encoder(posed, moving) - self.encoder(rest, weights)
        return out

    def decoded(self, pose: torch.Tensor, shape: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """Transforms of the target's parts, shape (B, K, 7), quaternions of length 1.

        Args:
            pose: Codes of the posed source less those of the source at rest, shape (B, K, C).
            shape: Codes of the target, shape (B, K, C).
            own: Transforms of the source's parts, shape (B, K, 7).
        """
        said = self.decoder(torch.cat([pose, shape, own], dim=2))
        if self.config.correction:
            said = said + own
        return torch.cat([said[..., :3], nn.functional.normalize(said[..., 3:], dim=2)], dim=2)


def part_centres(points: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """h, the mean of the vertices by the column-normalised weights, shape (K, 3).

    Args:
        points: Of one mesh, shape (M, 3).
        weights: Shape (M, K).
    """
    return shares_of(weights, [len(weights)])[0].T @ points


def affine_of(centres: torch.Tensor, transforms: torch.Tensor) -> torch.Tensor:
    """Affine transforms of parts that turn about their centres, `R (v - h) + h + t`, shape (..., K, 3, 4).

    Args:
        centres: h, shape (..., K, 3).
        transforms: Translation t and unit quaternion of each part, shape (..., K, 7).
    """
    turns = matrix_from_quaternion(transforms[..., 3:].roll(-1, dims=-1))
    shifts = centres + transforms[..., :3] - (turns @ centres[..., None])[..., 0]
    return torch.cat([turns, shifts[..., None]], dim=-1)
