"""The networks of Skeleton-free Pose Transfer (Liao et al., ECCV 2022): parts of a mesh, codes of their pose and shape,
and how the parts of a target move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from bunraku.geometry.rotations import matrix_from_quaternion
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.baselines.part_graph import GraphUnit, PartGraph, dense, per_mesh_max, shares_of
from bunraku_lab.nn.checkpoints import load_network, save_network

__all__ = ["TransferConfig", "TransferNetwork", "affine_of", "load_transfer", "part_centres", "save_transfer"]

KIND = "transfer"


@dataclass(frozen=True)
class TransferConfig:
    """Shape of the networks.

    Args:
        parts: K.
        predictor: Whether the weights of the parts are predicted here; otherwise they are given.
        tied: Of the parts, so many are given joints, the first ones: their transforms are known, and no decoder says
            them.
        levels: Channels of the graph units.
        code: Channels of a part's code.
        correction: Whether the decoder says how a target's part differs from the source's own, which it begins as; the
            paper's says the whole transform.
    """

    parts: int = 30
    predictor: bool = False
    tied: int = 0
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


class PartPredictor(nn.Module):
    """Weights of the parts at each vertex, shape (N, K), rows sum to 1; and what the softmax is of."""

    def __init__(self, config: TransferConfig):
        super().__init__()
        self.levels = _Levels(config.levels)
        self.head = dense(sum(config.levels), 256, 256, 128)
        self.last = nn.Linear(128, config.parts)

    def forward(self, graph: PartGraph) -> torch.Tensor:
        out: torch.Tensor = self.last(self.head(self.levels(graph)))
        return out


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


class TransferNetwork(nn.Module):
    """The network: predictor, one encoder for shape and pose, decoder.

    Args:
        config: Its shape.
    """

    def __init__(self, config: TransferConfig | None = None):
        super().__init__()
        self.config = config = config or TransferConfig()
        self.predictor = PartPredictor(config) if config.predictor else None
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

    def weights(self, graph: PartGraph) -> torch.Tensor:
        """Predicted weights of the parts, shape (N, K)."""
        assert self.predictor is not None
        return self.predictor(graph).softmax(dim=1)

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
        """Codes of the source in its poses less those of the source at rest, shape (B, K, C); arguments are those of
        `forward`.
        """
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


def save_transfer(
    path: str | Path, model: TransferNetwork, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "transfer"."""
    return save_network(path, model, KIND, note, half)


def load_transfer(path: str | Path) -> TransferNetwork:
    """Read a checkpoint of kind "transfer", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, KIND, lambda shape: TransferNetwork(config_of(TransferConfig, shape)))
