"""The network that knows which way up a character belongs and which way it faces, as it runs.

The laboratory has its definition: it scores one orientation, and a softmax compares the 24.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.geometry.axes import right_angle_rotations
from bunraku.handles.inference.graph import farthest_points
from bunraku.nn.checkpoints import config_of, load_network
from bunraku.nn.layers import PreNorm, gelu, softmax
from bunraku.nn.weights import Weights

__all__ = [
    "TOKEN",
    "OrientationConfig",
    "OrientationPredictor",
    "load_orientation_predictor",
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


def turned_tokens(tokens: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Tokens of a mesh turned by each of some rotations by right angles, shapes (M, 10), (R, 3, 3) -> (R, M, 10)."""
    back = rotations.swapaxes(-1, -2)
    shares = np.broadcast_to(tokens[:, 9:], (len(rotations), len(tokens), 1))
    return np.concatenate([tokens[:, :3] @ back, tokens[:, 3:6] @ back, tokens[:, 6:9] @ np.abs(back), shares], axis=-1)


class OrientationPredictor:
    """A transformer over the tokens of a mesh, and one number at its end: how upright and forward the mesh stands.

    Args:
        config: Its shape.
        weights: Of a checkpoint.

    Raises:
        ValueError: The weights have other sizes.
    """

    def __init__(self, config: OrientationConfig, weights: Weights):
        self.config = config
        width = config.width
        self._enter = weights.linear("enter.0", TOKEN, width), weights.linear("enter.2", width, width)
        self._layers = [
            PreNorm(
                part.attention("attention", "merge", width, config.heads),
                part.norm("norm", width),
                part.feed_forward("mix.1", "mix.3", width, 2 * width),
                part.norm("mix.0", width),
            )
            for part in (weights.part(f"layers.{index}") for index in range(config.layers))
        ]
        self._norm = weights.norm("norm", width)
        self._head = weights.linear("head.0", 2 * width, width), weights.linear("head.2", width, 1)
        self._rotations = right_angle_rotations().astype(np.float32)

    def __call__(self, tokens: np.ndarray) -> np.ndarray:
        """Score of each mesh as it stands, shape (B, M, 10) -> (B,)."""
        x = self._enter[1](gelu(self._enter[0](tokens)))
        for layer in self._layers:
            x = layer(x)
        x = self._norm(x)
        pooled = np.concatenate([x.mean(axis=1), x.max(axis=1)], axis=-1)
        return self._head[1](gelu(self._head[0](pooled)))[:, 0]

    def probabilities(self, tokens: np.ndarray) -> np.ndarray:
        """How likely each of `geometry.axes.ORIENTATIONS` is the right one, from the mesh and its mirror image, shape
        (M, 10) -> (24,), float64.
        """
        mirror = np.array([-1, 1, 1, -1, 1, 1, 1, 1, 1, 1], np.float32)
        turned = turned_tokens(tokens, self._rotations)
        scores = np.concatenate([self(part) for part in (*np.split(turned, 4), *np.split(turned * mirror, 4))])
        return softmax(scores.astype(np.float64).reshape(2, -1).mean(axis=0) / self.config.temperature)


def load_orientation_predictor(path: str | Path) -> OrientationPredictor:
    """Read a checkpoint of kind "orientation", ready to predict.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path,
        "orientation",
        lambda shape, weights: OrientationPredictor(config_of(OrientationConfig, shape), weights),
        key="predictor",
    )
