"""The body network of section 4.2: skinning weights for the 22 joints from features of each joint that geodesic
attention merges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from bunraku.body.layout import JOINT_COUNT
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.apparel.graph import EdgeBlock, NodeGraph
from bunraku_lab.nn.checkpoints import load_network, save_network

__all__ = ["BodyConfig", "BodyNetwork", "load_body", "save_body"]

JOINT_INPUT = 3 + 1 + 3
"""Of a vertex and a joint: the way from it, its length, the vertex normal."""

SHARPNESS = 32.0
"""Of the attention before it has learned, a unit of the height."""
FLOOR = 1e-6
"""Of the attention where weights begin with it: a joint that it leaves out can come back."""


@dataclass(frozen=True)
class BodyConfig:
    """Shape of the network.

    Args:
        features: Channels D of the features of a joint.
        width: Channels of the PointNet f_s.
        geodesics: "attention" is Eq. 5 and 6; "none" goes without geodesic distances, every joint counting the same;
            "sorted" puts the ways to the joints in the order of these distances (RigNet's form, Table 4).
    """

    features: int = 24
    width: int = 96
    geodesics: Literal["attention", "none", "sorted"] = "attention"


class BodyNetwork(nn.Module):
    """The network.

    Args:
        config: Its shape.
    """

    def __init__(self, config: BodyConfig | None = None):
        super().__init__()
        self.config = config = config or BodyConfig()
        wide = config.features
        self.joint_codes = nn.Parameter(0.1 * torch.randn(JOINT_COUNT, wide))
        self.encoder = nn.Sequential(nn.Linear(JOINT_INPUT, 32), nn.GELU(), nn.Linear(32, wide))
        last = nn.Linear(64, JOINT_COUNT)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.attention = nn.Sequential(nn.Linear(JOINT_COUNT, 64), nn.GELU(), last)
        self.sharpness = nn.Parameter(torch.tensor(SHARPNESS).log())
        entering = {"attention": wide + JOINT_COUNT, "none": wide, "sorted": 4 * JOINT_COUNT}[config.geodesics] + 6
        self.enter = nn.Sequential(nn.Linear(entering, config.width), nn.GELU(), nn.Linear(config.width, config.width))
        self.block = EdgeBlock(config.width)
        self.pooled = nn.Linear(config.width, config.width)
        self.decoder = nn.Sequential(
            nn.Linear(2 * config.width, config.width), nn.GELU(), nn.Linear(config.width, JOINT_COUNT)
        )

    def attention_map(self, geodesics: torch.Tensor) -> torch.Tensor:
        """M = Softmax(f_m(G)), how much each joint counts for each vertex [MMDMC 5], shape (N, J) -> (N, J).

        f_m begins as -32 G with G over the height, so that M begins as the prior that the distances are: the joint that
        is nearest along the surface, and others where they are nearly as near. How sharp it is is learned, and an MLP
        of how close all joints are, exp(-8 G), is added to it, which says nothing before it has learned.
        """
        far = self.attention(torch.exp(-8 * geodesics)) - self.sharpness.exp() * geodesics
        out: torch.Tensor = torch.softmax(far, dim=1)
        return out

    def fused(self, features: torch.Tensor, attention: torch.Tensor) -> torch.Tensor:
        """P'_i = sum_j P_ij M_ij [MMDMC 6], shapes (N, J, D) and (N, J) -> (N, D)."""
        return torch.einsum("njd,nj->nd", features, attention)

    def forward(
        self, points: torch.Tensor, normals: torch.Tensor, joints: torch.Tensor, geodesics: torch.Tensor,
        graph: NodeGraph,
    ) -> torch.Tensor:  # fmt: skip
        """Skinning weights W = Softmax(f_s(P')) [MMDMC 7], shape (N, J), rows sum to 1.

        Beside P' ours is given the place, the normal and the attention map itself, and what it says of a joint is how
        much more or less than M that joint holds the vertex: W = Softmax(log M + f_s), so that it begins as M. Where
        every joint counts the same, log M is nothing.

        Args:
            points: Of B meshes in units of their heights (`SampledMesh.points`), shape (N, 3).
            normals: Shape (N, 3).
            joints: J of each mesh in the same units, shape (B, J, 3).
            geodesics: G over the height, shape (N, J).
            graph: Neighbours, loose parts and meshes of the points.
        """
        way = points[:, None] - joints[graph.owner]
        length = way.norm(dim=2, keepdim=True)
        own = torch.cat([points, normals], dim=1)
        prior = points.new_zeros(1, JOINT_COUNT)
        if self.config.geodesics == "sorted":
            order = geodesics.argsort(dim=1)
            both = torch.cat([way, geodesics[..., None]], dim=2)
            fused = both.gather(1, order[..., None].expand_as(both)).flatten(1)
        else:
            pair = torch.cat([way, length, normals[:, None].expand_as(way)], dim=2)
            features = self.encoder(pair) + self.joint_codes
            if self.config.geodesics == "attention":
                attention = self.attention_map(geodesics)
                fused = torch.cat([self.fused(features, attention), 4 * attention], dim=1)
                prior = torch.log(attention + FLOOR)
            else:
                fused = features.mean(dim=1)  # Eq. 6 with the same attention for each joint
        x = self.block(self.enter(torch.cat([fused, own], dim=1)), graph)
        rows = graph.owner[:, None].expand_as(x)
        whole = x.new_full((len(joints), x.shape[1]), -1e4).scatter_reduce(0, rows, x, "amax")
        out: torch.Tensor = self.decoder(torch.cat([x, self.pooled(whole)[graph.owner]], dim=1))
        return torch.softmax(prior + out, dim=1)


def save_body(
    path: str | Path, model: BodyNetwork, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "apparel-body"."""
    return save_network(path, model, "apparel-body", note, half)


def load_body(path: str | Path) -> BodyNetwork:
    """Read a checkpoint of kind "apparel-body", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, "apparel-body", lambda shape: BodyNetwork(config_of(BodyConfig, shape)))
