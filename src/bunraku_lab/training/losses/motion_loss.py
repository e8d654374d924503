"""The motion loss L_m (Eq. 6 of TapMo): masked, weighted squared error of x0 and of its change from frame to frame."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["motion_losses"]


def motion_losses(predicted: Tensor, clean: Tensor, lengths: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Motion Loss L_m of each row [TapMo 6], and its like for the change from frame to frame.

    Args:
        predicted: Predicted x0 in network units, shape (B, N, D).
        clean: True x0, shape (B, N, D).
        lengths: Real frames, shape (B,).
        weights: Weight of each feature, shape (D,), mean 1.

    Returns:
        Mean squared error (B,), and that of frame differences (B,); padded frames do not count.
    """
    error = (predicted.float() - clean) * weights.sqrt()
    real = torch.arange(clean.shape[1], device=clean.device) < lengths[:, None]
    error = error * real[..., None]
    features = clean.shape[-1]
    position = error.square().sum((1, 2)) / (lengths * features)
    change = (error[:, 1:] - error[:, :-1]) * real[:, 1:, None]
    return position, change.square().sum((1, 2)) / ((lengths - 1).clamp(min=1) * features)
