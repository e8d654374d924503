"""The network that knows which way up a character belongs and which way it faces.

It scores one orientation: how upright and forward does this mesh stand? The same network sees the mesh in all 24
right-angle rotations, and a softmax over the scores compares them. Whatever the file's axes, the 24 pictures are the
same ones, so turning a mesh by one of the 24 permutes the scores and changes nothing else: no orientation can be
favoured by accident.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import nn

from bunraku.geometry.axes import right_angle_rotations
from bunraku.handles.inference.orientation import TOKEN, OrientationConfig
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.checkpoints import load_network, save_network

__all__ = [
    "OrientationPredictor",
    "load_orientation_predictor",
    "save_orientation_predictor",
    "turned_tokens",
]


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
