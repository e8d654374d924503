"""Sampling: from noise and a sentence to a motion, with classifier-free guidance and frames that are known beforehand.

The default is DPM-Solver++ (2M) for networks that predict x0 (Lu et al. 2022, algorithm 2), which needs 10 to 30 steps; the
ancestral sampler of DDPM (Ho et al. 2020) is the reference beside it. The solver is written out here because importing
diffusers' takes twice as long as torch itself; a test holds the two together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from bunraku.diffusion.denoiser import Denoiser
from bunraku.diffusion.schedule import alphas_cumprod, sampling_steps
from bunraku.diffusion.text import TextBatch

__all__ = ["Known", "Sample", "ancestral", "dpm_solver", "guided", "sample", "starting_noise", "token_share"]

Predict = Callable[[Tensor, int], Tensor]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Known:
    """Frames that the motion must keep.

    Args:
        values: Clean frames in network units, shape (B, N, D); anything where `share` is 0.
        share: How far each frame is held, 1 for fully, shape (N,).
    """

    values: Tensor
    share: Tensor


@dataclass(frozen=True)
class Sample:
    """What a sampler gives.

    Args:
        values: Motions in network units, shape (B, N, D).
        adaptation: Offsets on the local translations [m], shape (B, N, K, 3).
    """

    values: Tensor
    adaptation: Tensor


def _moments(step: int, curve: Tensor) -> tuple[float, float, float]:
    """alpha, sigma and half the log of their ratio's square after `step`; step -1 is the clean motion."""
    share = float(curve[step]) if step >= 0 else 1.0
    alpha, sigma = math.sqrt(share), math.sqrt(1 - share)
    return alpha, sigma, math.log(alpha / sigma) if sigma > 0 else math.inf


def dpm_solver(predict: Predict, noise: Tensor, steps: list[int], progress: Progress | None = None) -> Tensor:
    """DPM-Solver++ (2M): from x_T to x_0 with one prediction of x0 a step.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, shape (B, N, D).
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


def ancestral(predict: Predict, noise: Tensor, steps: list[int], generator: torch.Generator, progress: Progress | None = None) -> Tensor:
    """The sampler of DDPM: draws each x_{t-1} from the posterior q(x_{t-1} | x_t, x0); with all 1,000 steps, the reference.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, shape (B, N, D).
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
        mean = math.sqrt(share_next) * (1 - kept) / (1 - share) * clean + math.sqrt(kept) * (1 - share_next) / (1 - share) * x
        variance = (1 - kept) * (1 - share_next) / (1 - share)
        x = mean + math.sqrt(variance) * torch.randn(x.shape, generator=generator).to(x) if variance > 0 else mean
        if progress is not None:
            progress(index + 1, len(steps))
    return x


def guided(conditional: Tensor, unconditional: Tensor, guidance: float, rescale: float = 0.0) -> Tensor:
    """Classifier-free guidance on x0 (Ho & Salimans 2022), brought back towards the conditional's deviation by the share
    `rescale` (Lin et al. 2023), shape (B, N, D)."""
    x0 = unconditional + guidance * (conditional - unconditional)
    if rescale > 0:
        factor = conditional.std((1, 2), keepdim=True) / x0.std((1, 2), keepdim=True).clamp(min=1e-8)
        x0 = x0 * (rescale * factor + 1 - rescale)
    return x0


def starting_noise(rows: int, frames: int, features: int, seed: int) -> Tensor:
    """x_T, shape (rows, frames, features). Row b draws from its own generator of (seed, b), on the CPU on every machine, so the
    first row is the same in a batch as alone."""
    return torch.stack([torch.randn(frames, features, generator=_generator(seed, row)) for row in range(rows)])


def _generator(seed: int, row: int) -> torch.Generator:
    return torch.Generator().manual_seed((seed + row * 0x9E3779B97F4A7C15) % 2**63)


def token_share(frames: int, patch: int) -> Tensor:
    """How far each frame trusts its token, shape (frames,): most in the middle, least at the edges."""
    return 1 - ((torch.arange(frames) % patch + 0.5) * 2 / patch - 1).abs()


@torch.inference_mode()
def sample(
    model: Denoiser,
    text: TextBatch,
    frames: int,
    *,
    mesh_features: Tensor | None = None,
    steps: int = 20,
    guidance: float = 2.5,
    rescale: float = 0.0,
    seed: int = 0,
    known: Known | None = None,
    method: str = "dpm",
    bf16: bool = False,
    progress: Progress | None = None,
) -> Sample:
    """Draw one motion for each sentence, all in one batch.

    Args:
        model: The denoiser.
        text: B encoded sentences.
        frames: Length N of the motions, at most the model's `frames`.
        mesh_features: f_phi of each row's character, shape (B, 448); None for no mesh in particular.
        steps: Predictions of x0 that are made, one after the other.
        guidance: Scale of classifier-free guidance; 1 is the conditional model alone and takes half the time.
        rescale: Share of guidance rescaling, 0 to 1.
        seed: Of the starting noise.
        known: Frames to keep: they overwrite the predicted x0 at each step (inpainting, as in MDM).
        method: "dpm", or "ddpm" for the ancestral reference.
        bf16: Let matrix products run in bfloat16.
        progress: Called with (done, total) steps.
    """
    device = model.mean.device
    rows, patch = len(text.mask), model.config.frames_per_token
    text = text.to(device)
    twice = 1 if guidance == 1 else 2
    mesh = None if mesh_features is None else mesh_features.to(device).float().repeat(twice, 1)
    keep_text = torch.arange(twice * rows, device=device) < rows
    keep_mesh = torch.full_like(keep_text, mesh is not None)
    held = None if known is None else (known.values.to(device), known.share.to(device)[:, None])
    visited = sampling_steps(steps)
    last: dict[str, Tensor] = {}
    with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
        tokens, mask, pooled = (part.repeat(twice, *[1] * (part.ndim - 1)) for part in (text.tokens, text.mask, text.pooled))
        condition = model.condition(tokens, mask, pooled, mesh, keep_text, keep_mesh)

    def run(x: Tensor, step: int) -> tuple[Tensor, Tensor]:
        whole = torch.full((twice * rows,), x.shape[1], device=device)
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            motion, adaptation = model(x.repeat(twice, 1, 1), torch.full_like(whole, step), whole, condition)
        motion = motion.float()
        return motion if twice == 1 else guided(motion[:rows], motion[rows:], guidance, rescale), adaptation[:rows].float()

    def predict(x: Tensor, step: int) -> Tensor:
        x0, adaptation = run(x, step)
        if step == visited[-1] and patch > 1:
            # Frames of one token agree better than neighbours across two: a second grid, moved by half a token, heals the seams.
            ahead = patch // 2
            other, other_adaptation = (part[:, ahead:] for part in run(torch.cat([x[:, :ahead].flip(1), x], 1), step))
            share = token_share(frames, patch).to(device)[:, None]
            x0, adaptation = torch.lerp(other, x0, share), torch.lerp(other_adaptation, adaptation, share[..., None])
        last["adaptation"] = adaptation
        return x0 if held is None else torch.lerp(x0, held[0], held[1])

    noise = starting_noise(rows, frames, model.config.features, seed).to(device)
    if method == "dpm":
        values = dpm_solver(predict, noise, visited, progress)
    elif method == "ddpm":
        values = ancestral(predict, noise, visited, _generator(seed, -1), progress)
    else:
        raise ValueError(f"there is no sampler '{method}'; take 'dpm' or 'ddpm'")
    return Sample(values, last["adaptation"])
