"""The losses of Skeleton-free Pose Transfer that no other training has."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["chamfer_loss", "far_points", "transform_loss", "weight_divergence"]

QUATERNION = 0.5
"""Weight of quaternions against translations."""


def transform_loss(transforms: Tensor, truth: Tensor) -> Tensor:
    """L1 of translations and half the L1 of quaternions, whose sign says nothing, mean over the parts.

    Args:
        transforms: Translation and unit quaternion of each part, shape (..., K, 7).
        truth: The same of the truth, shape (..., K, 7).
    """
    shift = (transforms[..., :3] - truth[..., :3]).abs().sum(-1)
    own, true = transforms[..., 3:], truth[..., 3:]
    turn = torch.minimum((own - true).abs().sum(-1), (own + true).abs().sum(-1))
    return (shift + QUATERNION * turn).mean()


def far_points(points: Tensor, count: int) -> Tensor:
    """Rows of farthest-point samples, shape (count,): each is the farthest from those before it, the first is the one
    farthest from the mean.

    Args:
        points: Shape (M, 3).
        count: At most M are taken.
    """
    away = (points - points.mean(0)).square().sum(1)
    chosen: list[Tensor] = []
    gap = torch.full_like(away, torch.inf)
    for _ in range(min(count, len(points))):
        row = away.argmax() if not chosen else gap.argmax()
        chosen.append(row)
        gap = torch.minimum(gap, (points - points[row]).square().sum(1))
    return torch.stack(chosen)


def chamfer_loss(centres: Tensor, points: Tensor) -> Tensor:
    """The Chamfer distance of the parts' centres from points of the mesh: mean squared distance to the nearest of the
    other set, both ways.

    Args:
        centres: Shape (K, 3).
        points: Shape (P, 3).
    """
    squares = (centres[:, None] - points[None]).square().sum(-1)
    return squares.amin(1).mean() + squares.amin(0).mean()


def weight_divergence(logits: Tensor, other: Tensor) -> Tensor:
    """Mean Kullback-Leibler divergence of two predictions for the same vertices, the second being held.

    Args:
        logits: Of the first before the softmax, shape (M, K).
        other: Of the second, shape (M, K).
    """
    log, held = logits.log_softmax(-1), other.detach().log_softmax(-1)
    return (held.exp() * (held - log)).sum(-1).mean()
