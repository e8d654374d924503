"""The networks of a character at rest as they learn: the Mesh Handle Predictor (section 3.1 of TapMo), and
orientation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import nn

from bunraku.anatomy.handles import networks
from bunraku.anatomy.handles.networks import OrientationConfig, PredictorConfig, predictor_config, turned_tokens
from bunraku.core.geometry.axes import right_angle_rotations
from bunraku.core.nn.layers import through
from bunraku.errors import WeightsError
from bunraku_lab.nn.checkpoints import load_checkpoint
from bunraku_lab.nn.differentiable import Array, Trainable
from bunraku_lab.nn.graph import MeshGraph, largest_neighbour


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


class _ArrayGraph:
    """A mesh as the runtime's predictor reads it, of tensors."""

    def __init__(self, graph: MeshGraph):
        self._graph = graph
        self.inputs, self.areas, self.spread, self.gather, self.anchors = (
            Array(part) for part in (graph.inputs, graph.areas, graph.spread, graph.gather, graph.anchors)
        )

    def largest_neighbour(self, values: Array) -> Array:
        return Array(largest_neighbour(values.tensor, self._graph))


class HandlePredictor(Trainable):
    """`bunraku.anatomy.handles.networks.HandlePredictor` as it learns."""

    kind, shape, key, network = "handles", PredictorConfig, "predictor", networks.HandlePredictor

    @classmethod
    def config_from(cls, fields: dict[str, object]) -> PredictorConfig:
        return predictor_config(fields)

    def begin(self) -> None:
        """All rounds of the anchors but the first begin without effect, so that a deeper network begins as the
        shallower one that it grew from.
        """
        for name, value in self.named_parameters():
            _, block, rest = name.partition(".blocks.")
            if block and rest[:2] != "0." and rest.split(".", 1)[1].startswith(("merge", "mix.2")):
                nn.init.zeros_(value)

    def forward(self, graph: MeshGraph) -> HandlePrediction:
        logits, features = (part.tensor.float() for part in self.learning().logits(_ArrayGraph(graph)))
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


class OrientationPredictor(Trainable):
    """`bunraku.anatomy.handles.networks.OrientationPredictor` as it learns."""

    kind, shape, key, network = "orientation", OrientationConfig, "predictor", networks.OrientationPredictor

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Score of each mesh as it stands, shape (B, M, 10) -> (B,)."""
        return cast(torch.Tensor, cast(Any, through(self.learning().layers, cast(Any, Array(tokens)))).tensor[:, 0])

    def scores(self, tokens: np.ndarray, chosen: Any = slice(None)) -> torch.Tensor:
        """Scores of meshes in the orientations that are `chosen` among the 24, shape (B, M, 10) -> (B, R)."""
        turned = turned_tokens(tokens, right_angle_rotations()[chosen].astype(np.float32))
        first = next(self.parameters())
        result: torch.Tensor = self(torch.from_numpy(turned.reshape(-1, *turned.shape[2:])).to(first.device))
        return result.reshape(turned.shape[:2])
