"""The joint refinement f_j of section 4.4: a light MLP that merges what the body and the apparel module say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.checkpoints import load_network, save_network
from bunraku_lab.training.apparel.networks.seam import BASIS, INPUTS, Seam

__all__ = ["RefinementConfig", "RefinementNetwork", "load_refinement", "refined", "save_refinement"]

MOST = 1.0  # largest weight of a basis vector
FREE = 0.01  # largest refinement beside them, over the character's size


@dataclass(frozen=True)
class RefinementConfig:
    """Shape of the network.

    Args:
        width: Channels.
    """

    width: int = 48


class RefinementNetwork(nn.Module):
    """The network.

    Args:
        config: Its shape.
    """

    def __init__(self, config: RefinementConfig | None = None):
        super().__init__()
        self.config = config = config or RefinementConfig()
        last = nn.Linear(config.width, BASIS + 3)
        self.layers = nn.Sequential(
            nn.Linear(INPUTS, config.width), nn.GELU(), nn.Linear(config.width, config.width), nn.GELU(), last
        )
        nn.init.zeros_(last.weight)  # it begins with both modules' results as they are
        nn.init.zeros_(last.bias)

    def forward(self, inputs: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Change of each vertex, which is added to tile(A, B) [MMDMC 16], shape (S, 3).

        In the frame of the joint that carries the vertex and over the character's size, as what it is made of. The
        paper's MLP reads the positions; ours reads how a vertex lies to those around it, so that it fits any mesh.

        Args:
            inputs: `SeamFrame.inputs`, shape (S, INPUTS).
            vectors: `SeamFrame.vectors`, shape (S, BASIS, 3).
        """
        out = self.layers(inputs)
        mixed: torch.Tensor = torch.einsum("sk,ska->sa", MOST * torch.tanh(out[:, :BASIS]), vectors)
        return mixed + FREE * torch.tanh(out[:, BASIS:])


@torch.no_grad()
def refined(network: RefinementNetwork, seam: Seam, positions: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """A frame after the refinement, all vertices of the mesh [m], shape (V, 3).

    Args:
        network: The network.
        seam: Of the clothed.
        positions: Both modules' results tiled [m], shape (V, 3).
        affine: Affine transforms of the joints, shape (22, 3, 4).
    """
    out = np.array(positions, np.float32)
    if len(seam.vertices):
        frame = seam.frame(positions, affine)
        change = network(torch.from_numpy(frame.inputs), torch.from_numpy(frame.vectors)).numpy()
        world = np.einsum("sab,sb->sa", frame.turns, change) * np.float32(seam.scale)
        out[seam.copies] += world[seam.rows]
    return out


def save_refinement(
    path: str | Path, model: RefinementNetwork, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "apparel-refinement"."""
    return save_network(path, model, "apparel-refinement", note, half)


def load_refinement(path: str | Path) -> RefinementNetwork:
    """Read a checkpoint of kind "apparel-refinement", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, "apparel-refinement", lambda shape: RefinementNetwork(config_of(RefinementConfig, shape)))
