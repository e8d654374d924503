"""Weighted rigid registration for training: `geometry.registration` in torch, with a gradient that stays finite."""

from __future__ import annotations

from typing import Any

import torch

from bunraku.geometry.registration import EMPTY, PULL

__all__ = ["register_torch"]


def register_torch(
    source: torch.Tensor, targets: torch.Tensor, weights: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`register` for training: differentiable in the weights, the source and the targets.

    The rotation's gradient is that of the polar factor, `U [(B - B^T) / (s_i + s_j)] V^T` with B the incoming gradient
    in the frames of U and V. It divides by sums of singular values, not by their differences as the gradient of an SVD
    does, so it is finite where singular values coincide. Where a sum vanishes too (points on a line), the rotation
    takes no gradient.

    Args:
        source: Rest vertices [m], shape (V, 3).
        targets: Moved vertices [m], shape (N, V, 3).
        weights: Skinning weights, shape (V, K).

    Returns:
        Rotations (N, K, 3, 3), translations (N, K, 3) [m] and handles (K, 3) [m], in the type of the source.
    """
    kind = source.dtype
    source, targets, weights = source.double(), targets.double(), weights.double()
    total = weights.sum(0)
    empty = total <= EMPTY * len(source)
    shares = torch.where(
        empty, torch.full_like(weights, 1 / len(source)), weights / torch.where(empty, torch.ones_like(total), total)
    )
    means = shares.T @ source
    arms = source[:, None] - means
    spread = (arms.detach().square().sum(-1) * shares.detach()).sum(0)
    middle = source.detach().mean(0)
    moved = targets - middle
    moved_means = torch.einsum("nvi,vk->nki", moved, shares) + middle
    covariance = torch.einsum("nvi,vkj->nkij", moved, arms * (shares * ~empty)[..., None])
    covariance = covariance + (PULL * spread + (spread <= 0))[:, None, None] * torch.eye(
        3, dtype=covariance.dtype, device=covariance.device
    )
    rotations = _polar_rotation(covariance)
    return rotations.to(kind), (moved_means - means).to(kind), means.to(kind)


def _polar_rotation(matrix: torch.Tensor) -> torch.Tensor:
    """The nearest rotation to each 3x3 matrix, shape [..., 3, 3], with a gradient that stays finite."""

    class Polar(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, value: torch.Tensor) -> torch.Tensor:
            u, s, vt = torch.linalg.svd(value)
            sign = torch.sign(torch.linalg.det(u) * torch.linalg.det(vt))
            flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
            u, s = u * flip[..., None, :], s * flip
            ctx.save_for_backward(u, s, vt)
            return u @ vt

        @staticmethod
        def backward(ctx: Any, *gradients: Any) -> torch.Tensor:
            u, s, vt = ctx.saved_tensors
            b = u.mT @ gradients[0] @ vt.mT
            sums = s[..., :, None] + s[..., None, :]
            safe = sums > 1e-6 * s[..., :1, None]
            inner = torch.where(safe, (b - b.mT) / torch.where(safe, sums, torch.ones_like(sums)), torch.zeros_like(b))
            return u @ inner @ vt

    result: torch.Tensor = Polar.apply(matrix)  # type: ignore[no-untyped-call]
    return result
