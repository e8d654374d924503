"""The noise schedule: cosine, 1,000 steps (Nichol & Dhariwal 2021), and the steps that a sampler visits."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

__all__ = ["TRAINING_STEPS", "add_noise", "alphas_cumprod", "sampling_steps"]

TRAINING_STEPS = 1000
RATIOS = (-6.0, 4.0)  # lambda near the first step that a sampler visits, and at the last: 997 and 5


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
    """Training steps that a sampler of `count` steps, 1 to 1,000, visits: falling from 999, even in the log of the
    signal-to-noise ratio.

    The high end decides what happens and the low end how crisply, and both get more of such steps than of even ones: 20
    even steps lose a sixth of the motion's spread and end four times as far from the limit of many steps. 12 of these
    end nearer to it than 20 that are dense at both ends as a cosine is.
    """
    curve = alphas_cumprod()
    ratio = 0.5 * torch.log(curve / (1 - curve)).numpy()  # the lambda of DPM-Solver++, falling
    wanted = np.interp(np.linspace(*RATIOS, count), ratio[::-1], np.arange(TRAINING_STEPS)[::-1])
    steps: list[int] = []
    for index, step in enumerate(wanted):
        below = steps[-1] - 1 if steps else TRAINING_STEPS - 1
        even = round(float(step)) if steps else below
        steps.append(max(min(even, below), count - 1 - index))  # no step twice, and room for those to come
    return steps
