"""The segmentation network f_c of section 4.1: which vertices are apparel, and how stiff they are.

A PointNet (Qi et al. 2017): an MLP on each point, pooled over the mesh, and an MLP that reads both. Ours also pools
over the loose part that a point belongs to, and is conditioned on its neighbours there and on the nearest bones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import nn

from bunraku.apparel.sampled_mesh import POINT_FEATURES, SampledMesh
from bunraku.apparel.segmentation.scores import SegmentationConfig
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.apparel.graph import EdgeBlock, NodeGraph, node_graph
from bunraku_lab.nn.checkpoints import load_network, save_network

__all__ = ["SegmentationNetwork", "load_segmentation", "mesh_block", "save_segmentation"]


class SegmentationNetwork(nn.Module):
    """The network.

    Args:
        config: Its shape.
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, config: SegmentationConfig | None = None):
        super().__init__()
        self.config = config = config or SegmentationConfig()
        width = config.width
        self.register_buffer("mean", torch.zeros(POINT_FEATURES))
        self.register_buffer("std", torch.ones(POINT_FEATURES))
        self.enter = nn.Sequential(nn.Linear(POINT_FEATURES, width), nn.GELU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(EdgeBlock(width) for _ in range(config.blocks))
        self.pooled = nn.Linear(width, width)
        self.decoder = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 3))

    def scores(self, features: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
        """Before the sigmoid: apparel, stiffness and log10 of what a second of damping leaves, shape (S, 3).

        Args:
            features: Of the points of B meshes, shape (S, POINT_FEATURES).
            graph: Their neighbours, loose parts and meshes.
        """
        x = self.enter(((features - self.mean) / self.std).clamp(-6, 6))
        for block in self.blocks:
            x = block(x, graph)
        meshes = int(graph.owner.max()) + 1
        rows = graph.owner[:, None].expand_as(x)
        whole = x.new_full((meshes, x.shape[1]), -1e4).scatter_reduce(0, rows, x, "amax")
        out: torch.Tensor = self.decoder(torch.cat([x, self.pooled(whole)[graph.owner]], dim=1))
        return out

    def forward(self, features: torch.Tensor, graph: NodeGraph) -> torch.Tensor:
        """Probability of each point to be apparel, Sigmoid(f_c(V)) [MMDMC 2], shape (S,)."""
        return torch.sigmoid(self.scores(features, graph)[:, 0])


def mesh_block(meshes: Sequence[SampledMesh]) -> tuple[torch.Tensor, NodeGraph]:
    """Features and graph of several meshes as one block."""
    features = torch.cat([torch.from_numpy(mesh.features) for mesh in meshes])
    return features, node_graph([mesh.neighbours for mesh in meshes], [mesh.part for mesh in meshes])


def save_segmentation(
    path: str | Path, model: SegmentationNetwork, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "apparel-mask"."""
    return save_network(path, model, "apparel-mask", note, half)


def load_segmentation(path: str | Path) -> SegmentationNetwork:
    """Read a checkpoint of kind "apparel-mask", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, "apparel-mask", lambda shape: SegmentationNetwork(config_of(SegmentationConfig, shape)))
