"""The noise schedule, the steps that a sampler visits, and the solver: from x_T to x_0 by predictions of x_0.

The schedule is the cosine of 1,000 steps (Nichol & Dhariwal 2021).

The solver is DPM-Solver++ (2M) for networks that predict x0 (Lu et al. 2022, algorithm 2), which needs 10 to 30 steps.
It is written out here because importing diffusers' takes twice as long as torch itself; a test holds the two together.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bunraku.diffusion.denoiser_config import TRAINING_STEPS

__all__ = ["alphas_cumprod", "dpm_solver", "sampling_steps"]


FEW, MANY = (4, (-3.5, 2.0)), (20, (-6.0, 4.0))
"""Of how many steps, the lambda near the first that a sampler visits and at the last: 980 and 78 of four, 999 and 5 of
twenty. Beyond them little changes from step to step, and few steps are better spent between.
"""


def alphas_cumprod() -> np.ndarray:
    """Share of signal power left after each step, shape (1000,), float64, falling; betas are capped at 0.999."""
    time = np.arange(TRAINING_STEPS + 1) / TRAINING_STEPS
    curve = np.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2
    betas = np.minimum(1 - curve[1:] / curve[:-1], 0.999)
    return np.cumprod(1 - betas)


def sampling_steps(count: int) -> list[int]:
    """Training steps that a sampler of `count` steps, 1 to 1,000, visits: falling, even in the log of the
    signal-to-noise ratio.

    The high end decides what happens and the low end how crisply, and both get more of such steps than of even ones: 20
    even steps lose a sixth of the motion's spread and end four times as far from the limit of many steps. 12 of these
    end nearer to it than 20 that are dense at both ends as a cosine is. Twenty and more begin with the last training
    step; fewer end their range earlier at both sides.
    """
    curve = alphas_cumprod()
    ratio = 0.5 * np.log(curve / (1 - curve))  # the lambda of DPM-Solver++, falling
    ends = np.array([np.interp(count, (FEW[0], MANY[0]), pair) for pair in zip(FEW[1], MANY[1], strict=True)])
    wanted = np.interp(np.linspace(ends[0], ends[1], count), ratio[::-1], np.arange(TRAINING_STEPS)[::-1])
    steps: list[int] = []
    for index, step in enumerate(wanted):
        below = steps[-1] - 1 if steps else TRAINING_STEPS - 1
        even = below if count >= MANY[0] and not steps else round(float(step))
        steps.append(max(min(even, below), count - 1 - index))  # no step twice, and room for those to come
    return steps


Predict = Callable[[np.ndarray, int], np.ndarray]
Progress = Callable[[int, int], None]


def _moments(step: int, curve: np.ndarray) -> tuple[float, float, float]:
    """alpha, sigma and half the log of their ratio's square after `step`; step -1 is the clean motion."""
    share = float(curve[step]) if step >= 0 else 1.0
    alpha, sigma = math.sqrt(share), math.sqrt(1 - share)
    return alpha, sigma, math.log(alpha / sigma) if sigma > 0 else math.inf


def dpm_solver(
    predict: Predict, noise: np.ndarray, steps: list[int], progress: Progress | None = None, order: int = 2
) -> np.ndarray:
    """DPM-Solver++ (2M): from x_T to x_0 with one prediction of x0 a step.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, of any shape.
        steps: Training steps to visit, falling.
        progress: Called with (done, total).
        order: 2; of order 1 it is DDIM (Song et al. 2021), which networks learn few steps by.
    """
    curve, x = alphas_cumprod(), noise
    before: tuple[np.ndarray, float] | None = None  # the last prediction and its lambda
    for index, step in enumerate(steps):
        _, sigma, here = _moments(step, curve)
        alpha_next, sigma_next, there = _moments(steps[index + 1] if index + 1 < len(steps) else -1, curve)
        clean = predict(x, step)
        direction = clean
        if order > 1 and before is not None and math.isfinite(there):  # second order: extrapolate in lambda
            ratio = (there - here) / (here - before[1])
            direction = clean + 0.5 * ratio * (clean - before[0])
        x = (sigma_next / sigma) * x - alpha_next * math.expm1(here - there) * direction
        before = (clean, here)
        if progress is not None:
            progress(index + 1, len(steps))
    return x
