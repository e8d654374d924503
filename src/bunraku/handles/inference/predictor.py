"""The Mesh Handle Predictor (section 3.1 of TapMo) as it runs: a mesh in, skinning weights of 30 handles and the mesh
feature out.

The laboratory has its definition. An edge convolution over ranks of neighbours is a gather and a maximum for each rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bunraku.body.layout import HANDLE_COUNT
from bunraku.handles.inference.graph import MeshGraph
from bunraku.nn.checkpoints import config_of, load_network
from bunraku.nn.layers import Linear, PreNorm, gelu, normed, softmax
from bunraku.nn.weights import Weights

__all__ = ["HandlePrediction", "HandlePredictor", "PredictorConfig", "load_predictor", "predictor_config"]

LEAST_VERTICES = 100
"""Of a network mesh that has room for all handles."""


@dataclass(frozen=True)
class PredictorConfig:
    """Shape of the network.

    Args:
        levels: Channels of the three graph layers; their sum is the length of f_phi.
        hidden: Channels inside the MLP.
        handles: K.
        heads: Attention heads among the anchors.
        anchors: Anchors of the coarse term.
        depth: Rounds in which the anchors of a layer pass messages to one another.
        mesh_vertices: Most vertices of the network mesh it was trained on, for
            `bunraku.geometry.simplify.network_mesh`.
    """

    levels: tuple[int, int, int] = (64, 128, 256)
    hidden: tuple[int, int] = (256, 128)
    handles: int = HANDLE_COUNT
    heads: int = 4
    anchors: int = 128
    depth: int = 3
    mesh_vertices: int = 2400


class HandlePrediction(NamedTuple):
    """What the predictor says of one mesh.

    Args:
        weights: Skinning weights s, rows sum to 1, shape (V, K).
        features: The mesh deformation feature f_phi, shape (448,).
    """

    weights: np.ndarray
    features: np.ndarray


class _GraphLayer:
    """`LayerNorm(EdgeConv(x) + spread(blocks(gather(x))))`, then GELU, shape (V, width_in) -> (V, width_out)."""

    def __init__(self, width_in: int, width_out: int, heads: int, depth: int, weights: Weights):
        own = weights.linear("fine.own", width_in, width_out)
        self.neighbour = weights.linear("fine.neighbour", width_in, width_out, bias=False)
        # what a vertex says of itself, less what its neighbours would hear of it
        self.own = Linear(own.matrix - self.neighbour.matrix, own.bias)
        self.enter = weights.linear("enter", width_in + 3, width_out)
        self.blocks = [  # rounds in which the anchors pass messages to one another
            PreNorm(
                part.attention("attention", "merge", width_out, heads),
                part.norm("norm_attention", width_out),
                part.feed_forward("mix.0", "mix.2", width_out, 2 * width_out),
                part.norm("norm_mix", width_out),
            )
            for part in (weights.part(f"blocks.{index}") for index in range(depth))
        ]
        self.norm = weights.norm("norm", width_out)

    def __call__(self, x: np.ndarray, graph: MeshGraph) -> np.ndarray:
        tokens = self.enter(np.concatenate([graph.gather @ x, graph.anchors], axis=-1))[None]
        for block in self.blocks:
            tokens = block(tokens)
        both = self.own(x)
        both += graph.largest_neighbour(self.neighbour(x))
        both += graph.spread @ tokens[0]
        return gelu(normed(both, self.norm))


class HandlePredictor:
    """Three graph layers and a three-layer MLP with softmax (A.2).

    Args:
        config: Its shape.
        weights: Of a checkpoint.

    Raises:
        ValueError: The weights have other sizes.
    """

    def __init__(self, config: PredictorConfig, weights: Weights):
        self.config = config
        widths = (6, *config.levels)
        self._layers = [
            _GraphLayer(*pair, config.heads, config.depth, weights.part(f"layers.{index}"))
            for index, pair in enumerate(zip(widths, widths[1:], strict=False))
        ]
        length, (first, second) = sum(config.levels), config.hidden
        self._local = weights.linear("local", length + 6, first)
        self._overall = weights.linear("overall", length, first, bias=False)
        self._norm = weights.norm("head.0", first)
        self._middle, self._last = (
            weights.linear("head.2", first, second),
            weights.linear("head.4", second, config.handles),
        )

    def __call__(self, graph: MeshGraph) -> HandlePrediction:
        """What it says of a mesh."""
        x, levels, pooled = graph.inputs, [], []
        for layer in self._layers:
            x = layer(x, graph)
            half = x.shape[1] // 2
            pooled += [x[:, :half].max(axis=0), graph.areas @ x[:, half:]]
            levels.append(x)
        features = np.concatenate(pooled)
        hidden = self._local(np.concatenate([*levels, graph.inputs], axis=-1))
        hidden += self._overall(features[None])
        return HandlePrediction(softmax(self._last(gelu(self._middle(gelu(self._norm(hidden)))))), features)


def predictor_config(shape: dict[str, object]) -> PredictorConfig:
    """The config of a predictor of a character's handles.

    Args:
        shape: As a checkpoint carries it.

    Raises:
        OptionError: A value is missing, unknown, or no size that a network has.
        ValueError: It is of other handles, or of meshes that have no room for them.
    """
    found = config_of(PredictorConfig, shape)
    if found.handles != HANDLE_COUNT or found.mesh_vertices < LEAST_VERTICES or found.anchors < 1:
        raise ValueError(
            f"it is of {found.handles} handles on meshes of {found.mesh_vertices} vertices with {found.anchors} "
            f"anchors, not of {HANDLE_COUNT} on {LEAST_VERTICES} or more"
        )
    return found


def load_predictor(path: str | Path) -> HandlePredictor:
    """Read a checkpoint of kind "handles", ready to predict.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path, "handles", lambda shape, weights: HandlePredictor(predictor_config(shape), weights), key="predictor"
    )
