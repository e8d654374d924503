"""Solvers: from x_T to x_0 by predictions of x_0.

The default is DPM-Solver++ (2M) for networks that predict x0 (Lu et al. 2022, algorithm 2), which needs 10 to 30 steps;
the ancestral sampler of DDPM (Ho et al. 2020) is the reference beside it. The solver is written out here because
importing diffusers' takes twice as long as torch itself; a test holds the two together.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from bunraku.diffusion.sampling.schedule import alphas_cumprod

__all__ = ["ancestral", "dpm_solver"]

Predict = Callable[[Tensor, int], Tensor]
Progress = Callable[[int, int], None]


def _moments(step: int, curve: Tensor) -> tuple[float, float, float]:
    """alpha, sigma and half the log of their ratio's square after `step`; step -1 is the clean motion."""
    share = float(curve[step]) if step >= 0 else 1.0
    alpha, sigma = math.sqrt(share), math.sqrt(1 - share)
    return alpha, sigma, math.log(alpha / sigma) if sigma > 0 else math.inf


def dpm_solver(predict: Predict, noise: Tensor, steps: list[int], progress: Progress | None = None) -> Tensor:
    """DPM-Solver++ (2M): from x_T to x_0 with one prediction of x0 a step.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, of any shape.
        steps: Training steps to visit, falling.
        progress: Called with (done, total).
    """
    curve, x = alphas_cumprod(), noise
    before: tuple[Tensor, float] | None = None  # the last prediction and its lambda
    for index, step in enumerate(steps):
        _, sigma, here = _moments(step, curve)
        alpha_next, sigma_next, there = _moments(steps[index + 1] if index + 1 < len(steps) else -1, curve)
        clean = predict(x, step)
        direction = clean
        if before is not None and math.isfinite(there):  # second order: extrapolate in lambda
            ratio = (there - here) / (here - before[1])
            direction = clean + 0.5 * ratio * (clean - before[0])
        x = (sigma_next / sigma) * x - alpha_next * math.expm1(here - there) * direction
        before = (clean, here)
        if progress is not None:
            progress(index + 1, len(steps))
    return x


def ancestral(
    predict: Predict, noise: Tensor, steps: list[int], generator: torch.Generator, progress: Progress | None = None
) -> Tensor:
    """The sampler of DDPM: draws each x_{t-1} from the posterior q(x_{t-1} | x_t, x0); with all 1,000 steps, the
    reference.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, of any shape.
        steps: Training steps to visit, falling.
        generator: Draws the noise of each step.
        progress: Called with (done, total).
    """
    curve, x = alphas_cumprod(), noise
    for index, step in enumerate(steps):
        share = float(curve[step])
        share_next = float(curve[steps[index + 1]]) if index + 1 < len(steps) else 1.0
        kept = share / share_next
        clean = predict(x, step)
        mean = (
            math.sqrt(share_next) * (1 - kept) / (1 - share) * clean
            + math.sqrt(kept) * (1 - share_next) / (1 - share) * x
        )
        variance = (1 - kept) * (1 - share_next) / (1 - share)
        x = mean + math.sqrt(variance) * torch.randn(x.shape, generator=generator).to(x) if variance > 0 else mean
        if progress is not None:
            progress(index + 1, len(steps))
    return x
