"""The noise schedule: cosine, 1,000 steps (Nichol & Dhariwal 2021), and the steps that a sampler visits."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["TRAINING_STEPS", "add_noise", "alphas_cumprod", "sampling_steps"]

TRAINING_STEPS = 1000


def alphas_cumprod() -> Tensor:
    """Share of signal power left after each step, shape (1000,), float64, falling; betas are capped at 0.999."""
    time = torch.arange(TRAINING_STEPS + 1, dtype=torch.float64) / TRAINING_STEPS
    curve = torch.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2
    betas = (1 - curve[1:] / curve[:-1]).clamp(max=0.999)
    return torch.cumprod(1 - betas, 0)


def add_noise(clean: Tensor, noise: Tensor, step: Tensor, curve: Tensor) -> Tensor:
    """x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) noise, shapes (B, N, D) and (B,) for the step."""
    share = curve.to(clean.device)[step].view(-1, *[1] * (clean.ndim - 1))
    return share.sqrt().to(clean.dtype) * clean + (1 - share).sqrt().to(clean.dtype) * noise


def sampling_steps(count: int) -> list[int]:
    """Training steps that a sampler of `count` steps visits, falling from 999, evenly spaced without 0 as in diffusers' "linspace";
    all of them from 1,000 on."""
    if count >= TRAINING_STEPS:
        return list(range(TRAINING_STEPS - 1, -1, -1))
    return [round(TRAINING_STEPS - 1 - index * (TRAINING_STEPS - 1) / count) for index in range(count)]
