"""The Spring Loss L_h (Eq. 7 of TapMo): handles of a limb keep their distances."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor

from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles

__all__ = ["LIMB_SPRINGS", "spring_loss", "springs_present"]

LIMB_SPRINGS: tuple[tuple[int, int], ...] = tuple(
    spring for side in SIDES for family in FAMILIES for spring in pairwise(limb_handles(side, family))
)
"""A of Eq. 7: which handles of the limbs are adjacent."""


def springs_present(present: Tensor, roles: Tensor) -> Tensor:
    """Which springs a character has: both ends have a surface and play their own parts, shape (..., 12), bool.

    Args:
        present: Whether a handle has a surface, shape (..., K).
        roles: The part that each plays, shape (..., K).
    """
    own = present & (roles == torch.arange(roles.shape[-1], device=roles.device))
    first, second = (torch.tensor(ends, device=own.device) for ends in zip(*LIMB_SPRINGS, strict=True))
    return own[..., first] & own[..., second]


def spring_loss(positions: Tensor, rest: Tensor, springs: Tensor, sigma: float = 0.0) -> Tensor:
    """Spring Loss L_h of each row [TapMo 7], shape (B,).

    With E the distance of two adjacent handles, and frame 0 the rest pose, it is the sum over springs and frames of
    `exp(-(E_0 + sigma)) (E_n - E_0)^2 + (E_n - E_{n-1})^2`. Rigid motion changes no distance, so positions may be
    local.

    Args:
        positions: Handle positions of each frame, h^1 to h^N, shape (B, N, K, 3).
        rest: Handle positions of the rest pose, h^0, shape (B, K, 3), in the same unit.
        springs: Which of `LIMB_SPRINGS` count, shape (B, 12).
        sigma: The hyper-parameter that softens all springs.
    """
    first, second = (torch.tensor(ends, device=positions.device) for ends in zip(*LIMB_SPRINGS, strict=True))
    frames = torch.cat([rest[:, None], positions], dim=1)
    distance = (frames[:, :, first] - frames[:, :, second]).square().sum(-1).add(1e-12).sqrt()
    still = distance[:, :1]
    stretch = torch.exp(-(still + sigma)) * (distance[:, 1:] - still).square()
    change = (distance[:, 1:] - distance[:, :-1]).square()
    return ((stretch + change) * springs[:, None]).sum((1, 2))
