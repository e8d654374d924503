"""Noise of the diffusion's schedule on clean motions, for training (Nichol & Dhariwal 2021)."""

from __future__ import annotations

import torch
from torch import Tensor

from bunraku.diffusion.sampling import solvers

__all__ = ["add_noise", "alphas_cumprod"]


def alphas_cumprod() -> Tensor:
    """Share of signal power left after each step, shape (1000,), float64, falling."""
    return torch.from_numpy(solvers.alphas_cumprod())


def add_noise(clean: Tensor, noise: Tensor, step: Tensor, curve: Tensor) -> Tensor:
    """x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) noise, shapes (B, N, D) and (B,) for the step."""
    share = curve.to(clean.device)[step].view(-1, *[1] * (clean.ndim - 1))
    return share.sqrt().to(clean.dtype) * clean + (1 - share).sqrt().to(clean.dtype) * noise
