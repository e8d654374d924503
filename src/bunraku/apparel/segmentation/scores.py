"""The segmentation network f_c of MMDMC 4.1 as it runs: which points of a mesh are apparel, and how stiff they are.

The laboratory has its definition (Eq. 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.apparel.node_graph import EdgeBlock, NodeGraph
from bunraku.apparel.sampled_mesh import POINT_FEATURES, SampledMesh
from bunraku.nn.checkpoints import config_of, load_network
from bunraku.nn.layers import gelu
from bunraku.nn.weights import Weights

__all__ = ["SegmentationConfig", "SegmentationNetwork", "load_segmentation"]


@dataclass(frozen=True)
class SegmentationConfig:
    """Shape of the network.

    Args:
        width: Channels.
        blocks: Edge convolutions within loose parts.
    """

    width: int = 96
    blocks: int = 2


class SegmentationNetwork:
    """The network.

    Args:
        config: Its shape.
        weights: Of a checkpoint.

    Raises:
        ValueError: The weights have other sizes.
    """

    def __init__(self, config: SegmentationConfig, weights: Weights):
        self.config = config
        width = config.width
        self._mean, self._std = weights.array("mean", POINT_FEATURES), weights.array("std", POINT_FEATURES)
        self._enter = weights.linear("enter.0", POINT_FEATURES, width), weights.linear("enter.2", width, width)
        self._blocks = [EdgeBlock(width, weights.part(f"blocks.{index}")) for index in range(config.blocks)]
        self._pooled = weights.linear("pooled", width, width)
        self._decoder = weights.linear("decoder.0", 2 * width, width), weights.linear("decoder.2", width, 3)

    def scores(self, mesh: SampledMesh) -> np.ndarray:
        """Before the sigmoid: apparel, stiffness and log10 of what a second of damping leaves, of each point of a mesh,
        shape (S, 3).
        """
        graph = NodeGraph(mesh.neighbours, mesh.part)
        known = np.clip((mesh.features - self._mean) / self._std, -6, 6)
        x = self._enter[1](gelu(self._enter[0](known)))
        for block in self._blocks:
            x = block(x, graph)
        whole = np.broadcast_to(self._pooled(x.max(axis=0, keepdims=True)), x.shape)
        return self._decoder[1](gelu(self._decoder[0](np.concatenate([x, whole], axis=1))))


def load_segmentation(path: str | Path) -> SegmentationNetwork:
    """Read a checkpoint of kind "apparel-mask", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path, "apparel-mask", lambda shape, weights: SegmentationNetwork(config_of(SegmentationConfig, shape), weights)
    )
