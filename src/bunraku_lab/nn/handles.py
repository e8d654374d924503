"""The networks of a character at rest: the Mesh Handle Predictor (section 3.1 of TapMo), and orientation."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import nn

from bunraku.anatomy.handles.networks import TOKEN, OrientationConfig, PredictorConfig, predictor_config
from bunraku.core.geometry.axes import right_angle_rotations
from bunraku.errors import WeightsError
from bunraku_lab.nn.checkpoints import SavedNetwork, load_checkpoint
from bunraku_lab.nn.graph import GraphLayer, MeshGraph


class HandlePrediction(NamedTuple):
    """What the predictor says of one mesh.

    Args:
        logits: Before the softmax, shape (V, K).
        weights: Skinning weights s, rows sum to 1, shape (V, K).
        features: The mesh deformation feature f_phi, shape (448,).
    """

    logits: torch.Tensor
    weights: torch.Tensor
    features: torch.Tensor


class HandlePredictor(SavedNetwork):
    """Three graph layers and a three-layer MLP with softmax (A.2).

    f_phi is the three levels pooled over the mesh and joined, 64 + 128 + 256 = 448 numbers: the first half of each
    level's channels by their largest value, the second half by their mean over the surface.
    """

    kind = "handles"
    shape = PredictorConfig
    key = "predictor"

    @classmethod
    def config_from(cls, fields: dict[str, object]) -> PredictorConfig:
        return predictor_config(fields)

    def __init__(self, config: PredictorConfig | None = None):
        super().__init__()
        self.config = config or PredictorConfig()
        widths = (6, *self.config.levels)
        self.layers = nn.ModuleList(
            GraphLayer(a, b, self.config.heads, self.config.depth) for a, b in zip(widths, widths[1:], strict=False)
        )
        length = sum(self.config.levels)
        first, second = self.config.hidden
        self.local = nn.Linear(length + 6, first)
        self.overall = nn.Linear(length, first, bias=False)
        self.head = nn.Sequential(
            nn.LayerNorm(first), nn.GELU(), nn.Linear(first, second), nn.GELU(), nn.Linear(second, self.config.handles)
        )

    def forward(self, graph: MeshGraph) -> HandlePrediction:
        x, levels, pooled = graph.inputs, [], []
        for layer in self.layers:
            x = layer(x, graph)
            half = x.shape[1] // 2
            pooled += [x[:, :half].amax(0), graph.areas @ x[:, half:].float()]
            levels.append(x)
        features = torch.cat([part.float() for part in pooled])
        hidden = self.local(torch.cat([*levels, graph.inputs], dim=-1)) + self.overall(features)
        logits = self.head(hidden).float()
        return HandlePrediction(logits, logits.softmax(-1), features)


def grow_predictor(model: HandlePredictor, path: str | Path) -> None:
    """Give a new predictor the weights of a checkpoint, which may have fewer rounds among the anchors.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or of another shape.
    """
    state, _ = load_checkpoint(path, "handles")
    try:
        missing, unexpected = model.load_state_dict(state, strict=False)
    except RuntimeError as error:
        raise WeightsError(
            f"{path}: the weights do not fit this predictor ({str(error).splitlines()[-1].strip()}); use its settings"
        ) from error
    if unexpected or any(".blocks." not in name for name in missing):
        raise WeightsError(
            f"{path}: the weights do not fit this predictor ({[*unexpected, *missing][0]}); use its settings"
        )


def rotated_tokens(tokens: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    """Tokens of the mesh in some rotations, shapes (..., M, 10), (R, 3, 3) -> (..., R, M, 10)."""
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


class OrientationPredictor(SavedNetwork):
    """A transformer over the tokens of a mesh, and one number at its end: how upright and forward the mesh stands."""

    kind = "orientation"
    shape = OrientationConfig
    key = "predictor"

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
        turned = rotated_tokens(tokens, self.rotations if rotations is None else rotations)
        result: torch.Tensor = self(turned.flatten(0, 1)).reshape(turned.shape[:2])
        return result

    def probabilities(self, tokens: torch.Tensor) -> torch.Tensor:
        """Probability of each of `ORIENTATIONS`, from the mesh and its mirror image, shape (M, 10) -> (24,)."""
        mirror = tokens.new_tensor([-1.0, 1, 1, -1, 1, 1, 1, 1, 1, 1])
        turned = rotated_tokens(tokens, self.rotations)
        scores = self(torch.cat([turned, turned * mirror])).reshape(2, -1).mean(dim=0)
        return (scores / self.config.temperature).softmax(-1)
