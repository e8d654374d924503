"""A network whose matrices learn a thin change alone: W + U D (low-rank adaptation, Hu et al. 2022)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

__all__ = ["LowRank", "changes_of", "with_changes"]


class LowRank(nn.Module):
    """W + U D, where W (O, I) stays as it is.

    Args:
        matrix: W.
        rank: Columns of U and rows of D. U begins at zero, so the network says at first what it said.
    """

    def __init__(self, matrix: Tensor, rank: int):
        super().__init__()
        rows, columns = matrix.shape
        self.up = nn.Parameter(torch.zeros(rows, rank))
        self.down = nn.Parameter(torch.randn(rank, columns) * columns**-0.5)

    def forward(self, matrix: Tensor) -> Tensor:
        """The changed matrix."""
        return matrix + self.up @ self.down


def with_changes(model: nn.Module, rank: int, without: tuple[str, ...] = ()) -> nn.Module:
    """The model itself, where every linear layer's matrix has a change of at most this rank that learns, and nothing
    else does.

    Args:
        model: Changed in place.
        rank: Of each change, less in smaller matrices.
        without: Layers by name that keep their matrices.
    """
    model.requires_grad_(False)
    for name, layer in list(model.named_modules()):
        if isinstance(layer, nn.Linear) and name not in without:
            change = LowRank(layer.weight, min(rank, *layer.weight.shape))
            parametrize.register_parametrization(layer, "weight", change)
    return model


def changes_of(model: nn.Module) -> dict[str, Tensor]:
    """U and D of each changed matrix, as "NAME.up" and "NAME.down"."""
    found = {}
    for name, layer in model.named_modules():
        if isinstance(layer, LowRank):
            matrix = name.replace(".parametrizations.weight.0", ".weight")
            found[f"{matrix}.up"], found[f"{matrix}.down"] = layer.up.detach(), layer.down.detach()
    return found
