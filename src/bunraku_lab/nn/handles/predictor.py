"""The Mesh Handle Predictor (section 3.1 of TapMo): a mesh in, skinning weights of 30 handles and the mesh feature
out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import torch
from torch import nn

from bunraku.errors import WeightsError
from bunraku.handles.inference.predictor import PredictorConfig, predictor_config
from bunraku_lab.nn.checkpoints import load_checkpoint, load_network, save_network
from bunraku_lab.nn.handles.graph import GraphLayer, MeshGraph

__all__ = [
    "HandlePrediction",
    "HandlePredictor",
    "grow_predictor",
    "load_predictor",
    "save_predictor",
]


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


class HandlePredictor(nn.Module):
    """Three graph layers and a three-layer MLP with softmax (A.2).

    f_phi is the three levels pooled over the mesh and joined, 64 + 128 + 256 = 448 numbers: the first half of each
    level's channels by their largest value, the second half by their mean over the surface.
    """

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


def save_predictor(
    path: str | Path, model: HandlePredictor, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "handles"."""
    return save_network(path, model, "handles", note, half, key="predictor")


def load_predictor(path: str | Path) -> HandlePredictor:
    """Read a checkpoint of kind "handles", ready to predict.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """

    return load_network(path, "handles", lambda shape: HandlePredictor(predictor_config(shape)), key="predictor")


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
