"""The network that knows which way up a character belongs and which way it faces.

It scores one orientation: how upright and forward does this mesh stand? The same network sees the mesh in all 24
right-angle rotations, and a softmax over the scores compares them. Whatever the file's axes, the 24 pictures are the
same ones, so turning a mesh by one of the 24 permutes the scores and changes nothing else: no orientation can be
favoured by accident.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from bunraku.geometry.axes import right_angle_rotations
from bunraku.handles.graph import farthest_points
from bunraku.nn.checkpoints import config_of, load_network, save_network

__all__ = [
    "OrientationConfig",
    "OrientationPredictor",
    "load_orientation_predictor",
    "save_orientation_predictor",
    "shape_tokens",
    "turned_tokens",
]

TOKEN = 10
"""Numbers a token has: mean position 3, mean normal 3, extent along each axis 3, share of the surface 1."""


@dataclass(frozen=True)
class OrientationConfig:
    """Shape of the network.

    Args:
        width: Channels.
        layers: Transformer layers.
        heads: Attention heads.
        anchors: Tokens of a mesh, M.
        temperature: Of the softmax over the 24 scores, fitted on characters that training did not see.
    """

    width: int = 64
    layers: int = 3
    heads: int = 4
    anchors: int = 128
    temperature: float = 1.0


def shape_tokens(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, anchors: int = 128) -> np.ndarray:
    """A surface as a few tokens: points spread over it, each with what is nearest to it.

    Args:
        points: Anywhere on the surface, any unit, shape (N, 3).
        normals: Their normals, shape (N, 3); shorter ones mean a bent surface.
        areas: Share of the surface that each stands for, any unit, shape (N,).
        anchors: How many tokens, M; fewer where there are fewer points.

    Returns:
        Mean position, mean normal, standard deviation along each axis and log of the share times M of each token, in
        units of the largest extent, the bounding box centred on 0, shape (M, 10), float32.
    """
    points = np.asarray(points, np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    points = (points - (low + high) / 2) / max(float((high - low).max()), 1e-300)
    chosen = points[farthest_points(points, min(anchors, len(points)))]
    squared = ((points[:, None, 0] - chosen[:, 0]) ** 2 + (points[:, None, 1] - chosen[:, 1]) ** 2) + (
        points[:, None, 2] - chosen[:, 2]
    ) ** 2
    owner = squared.argmin(axis=1)
    share = np.maximum(np.asarray(areas, np.float64), 0)
    share = share + 1e-3 * max(float(share.mean()), 1e-300)
    share = share / share.sum()
    mass = np.bincount(owner, share, len(chosen))
    safe = np.maximum(mass, 1e-12)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(owner, share * column, len(chosen)) for column in values.T], axis=1) / safe

    middle = mean(points)
    spread = np.sqrt(np.maximum(mean(points**2) - middle**2, 0))
    weight = np.log(np.maximum(mass * len(chosen), 1e-3))[:, None]
    return np.concatenate([middle, mean(np.asarray(normals, np.float64)), spread, weight], axis=1).astype(np.float32)


def turned_tokens(tokens: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    """Tokens of the mesh turned by each of some rotations by right angles, shapes (..., M, 10), (R, 3, 3) -> (..., R,
    M, 10).
    """
    parts = tokens.unsqueeze(-3)
    back = rotations.transpose(-1, -2)
    shares = parts[..., 9:].expand(*tokens.shape[:-2], len(rotations), -1, 1)
    return torch.cat([parts[..., :3] @ back, parts[..., 3:6] @ back, parts[..., 6:9] @ back.abs(), shares], -1)


class _Layer(nn.Module):
    """Attention and a two-layer MLP, each after a LayerNorm and added to what came in."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        if heads < 1 or width % heads:
            raise ValueError(f"{width} channels cannot be shared by {heads} heads")
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.attention = nn.Linear(width, 3 * width)
        self.merge = nn.Linear(width, width)
        self.mix = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        count, length, width = x.shape
        q, k, v = (
            self.attention(self.norm(x))
            .reshape(count, length, 3, self.heads, width // self.heads)
            .permute(2, 0, 3, 1, 4)
        )
        mixed = nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(count, length, width)
        x = x + self.merge(mixed)
        out: torch.Tensor = x + self.mix(x)
        return out


class OrientationPredictor(nn.Module):
    """A transformer over the tokens of a mesh, and one number at its end: how upright and forward the mesh stands."""

    rotations: torch.Tensor

    def __init__(self, config: OrientationConfig | None = None):
        super().__init__()
        self.config = config or OrientationConfig()
        width = self.config.width
        self.enter = nn.Sequential(nn.Linear(TOKEN, width), nn.GELU(), nn.Linear(width, width))
        self.layers = nn.ModuleList(_Layer(width, self.config.heads) for _ in range(self.config.layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 1))
        self.register_buffer("rotations", torch.from_numpy(right_angle_rotations()).float(), persistent=False)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Score of each mesh as it stands, shape (B, M, 10) -> (B,)."""
        x = self.enter(tokens)
        for layer in self.layers:
            x = layer(x)
        x = self.norm(x)
        pooled = torch.cat([x.mean(dim=1), x.amax(dim=1)], dim=-1)
        out: torch.Tensor = self.head(pooled)[:, 0]
        return out

    def scores(self, tokens: torch.Tensor, rotations: torch.Tensor | None = None) -> torch.Tensor:
        """Scores of meshes in several rotations, the 24 of `ORIENTATIONS` by default, shape (B, M, 10) -> (B, R)."""
        turned = turned_tokens(tokens, self.rotations if rotations is None else rotations)
        result: torch.Tensor = self(turned.flatten(0, 1)).reshape(turned.shape[:2])
        return result

    def probabilities(self, tokens: torch.Tensor) -> torch.Tensor:
        """How likely each of `ORIENTATIONS` is the right one, from the mesh and its mirror image, shape (M, 10) ->
        (24,).
        """
        mirror = tokens.new_tensor([-1.0, 1, 1, -1, 1, 1, 1, 1, 1, 1])
        turned = turned_tokens(tokens, self.rotations)
        scores = self(torch.cat([turned, turned * mirror])).reshape(2, -1).mean(dim=0)
        return (scores / self.config.temperature).softmax(-1)


def save_orientation_predictor(
    path: str | Path, model: OrientationPredictor, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "orientation"."""
    return save_network(path, model, "orientation", note, half, key="predictor")


def load_orientation_predictor(path: str | Path) -> OrientationPredictor:
    """Read a checkpoint of kind "orientation", ready to predict.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path, "orientation", lambda shape: OrientationPredictor(config_of(OrientationConfig, shape)), key="predictor"
    )
