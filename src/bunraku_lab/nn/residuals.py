"""How far parts may leave their joints, for training: `body.residuals` in torch."""

from __future__ import annotations

from torch import Tensor

from bunraku.body.residuals import LOOSE_ON_PEOPLE

__all__ = ["capped_on_people"]


def capped_on_people(residual: Tensor) -> Tensor:
    """Residuals of people in torch, shape [..., 3]; differentiable."""
    length = residual.square().sum(-1, keepdim=True).add(1e-18).sqrt()
    return residual * (LOOSE_ON_PEOPLE / length).clamp(max=1)
