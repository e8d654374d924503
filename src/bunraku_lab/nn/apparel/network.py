"""The whole displacement network f_d of section 4.3, and its checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import nn

from bunraku.apparel.displacement.weights import DisplacementConfig
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.apparel.anchor import AnchorHead
from bunraku_lab.nn.apparel.recurrent import RecurrentPart
from bunraku_lab.nn.checkpoints import load_network, save_network

__all__ = ["DisplacementNetwork", "load_displacement", "save_displacement"]


class DisplacementNetwork(nn.Module):
    """The head that cannot drift, and the recurrent part about it.

    Args:
        config: Its shape.
    """

    def __init__(self, config: DisplacementConfig | None = None):
        super().__init__()
        self.config = config = config or DisplacementConfig()
        self.anchor = AnchorHead(config.width, config.blocks)
        self.recurrent = (
            RecurrentPart(config.recurrent, config.blocks, config.frame == "world") if config.recurrent else None
        )


def save_displacement(
    path: str | Path, model: DisplacementNetwork, note: Mapping[str, object] | None = None, half: bool = False
) -> Path:
    """Write the weights with their config as a checkpoint of kind "apparel".

    Args:
        path: The file.
        model: The network.
        note: Anything else to carry.
        half: Store the matrices as float16.
    """
    return save_network(path, model, "apparel", note, half)


def load_displacement(path: str | Path) -> DisplacementNetwork:
    """Read a checkpoint of kind "apparel", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, "apparel", lambda shape: DisplacementNetwork(config_of(DisplacementConfig, shape)))


def normalize_inputs(model: DisplacementNetwork, nodes: torch.Tensor) -> None:
    """Set what the encoders subtract and divide by, from the features of many nodes, shape (M, NODE_INPUT)."""
    mean, std = nodes.mean(dim=0), nodes.std(dim=0).clamp(min=1e-3)
    for part in (model.anchor, model.recurrent):
        if part is not None:
            part.encoder.mean[: len(mean)] = mean
            part.encoder.std[: len(std)] = std
