"""The sampler that users have, on the device that learns: what a student of few steps is shown.

Guidance by the sentence and by the critic at each step, as `bunraku.diffusion.sampling` has them for arrays; a test
holds the two together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.extractor_config import RADIUS, SHORTEST
from bunraku.diffusion.sampling.classifier_guidance import LAST, SPREAD, STRENGTH
from bunraku.diffusion.sampling.sampler import GUIDED_FROM, ROOT, token_share
from bunraku.diffusion.sampling.solvers import dpm_solver, sampling_steps
from bunraku.geometry.filters import CUT
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.matching import Extractor
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.rows.drawn_rows import DrawnRows

__all__ = ["Teacher", "smoothed"]


class _Told(NamedTuple):
    """What does not depend on the step: conditions with and without the sentence, the critic's vectors of the sentences
    (B, E), and which rows it guides (B,).
    """

    sentence: tuple[Tensor, ...]
    nothing: tuple[Tensor, ...]
    goals: Tensor | None
    guided: Tensor


class Teacher:
    """A denoiser in many steps of DPM-Solver++.

    Args:
        model: The denoiser.
        critic: What guides people's motions; it reads the denoiser's text tokens. None for nothing.
        guidance: Scale of the guidance by sentences.
        steps: Of the sampler.
        bf16: Compute in bfloat16.
    """

    def __init__(self, model: Denoiser, critic: Extractor | None, guidance: float, steps: int = 20, bf16: bool = False):
        self.model, self.critic, self.guidance, self.bf16 = model, critic, guidance, bf16
        self.steps = sampling_steps(steps)

    def __call__(
        self, rows: DrawnRows, x: Tensor, start: int = 0, seen: Callable[[int, Tensor], None] | None = None
    ) -> Tensor:
        """Motions of rows, from x (B, N, D) at the sampler's step number `start`, in network units, shape (B, N, D).

        Args:
            rows: Sentences, lengths and characters; their motions are not looked at.
            x: Where the motions are.
            start: Of which step.
            seen: Called with each diffusion step and where the motions are there.
        """
        told = self._told(rows)

        def predict(x: Any, step: int) -> Any:
            if seen is not None:
                seen(step, x)
            return self._predict(x, step, rows.lengths, told)

        return cast(Tensor, dpm_solver(predict, cast(Any, x), self.steps[start:]))

    @torch.no_grad()
    def _told(self, rows: DrawnRows) -> _Told:
        text, yes = rows.text, torch.ones_like(rows.known)
        known = rows.known if rows.mesh is not None else ~yes
        with self._precision():
            sentence, nothing = (
                self.model.condition(text.tokens, text.mask, text.pooled, rows.mesh, keep, known, rows.examples)
                for keep in (yes, ~yes)
            )
        goals = None
        if self.critic is not None:
            size = self.critic.config.pooled_size
            goals = self.critic.text(TextBatch(text.tokens, text.mask, text.pooled[:, :size])) / RADIUS
        return _Told(sentence, nothing, goals, rows.person & (rows.lengths >= SHORTEST))

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.model.mean.device.type, torch.bfloat16, enabled=self.bf16)

    def _run(self, x: Tensor, step: int, lengths: Tensor, told: _Told) -> Tensor:
        """x0 as the sentence guides it, without the critic."""
        steps = torch.full((len(x),), step, device=x.device)
        with torch.no_grad(), self._precision():
            x0 = self.model(x, steps, lengths, told.sentence)[0].float()
            if step >= GUIDED_FROM and self.guidance != 1:
                unled = self.model(x, steps, lengths, told.nothing)[0].float()
                x0 = unled + self.guidance * (x0 - unled)
        return x0

    def _predict(self, x: Tensor, step: int, lengths: Tensor, told: _Told) -> Tensor:
        x0, patch = self._run(x, step, lengths, told), self.model.config.frames_per_token
        if step == self.steps[-1] and patch > 1:  # see `sampler._Group.predict`
            ahead = patch // 2
            moved = torch.cat([x[:, :ahead].flip(1), x], dim=1)
            other = self._run(moved, step, lengths + ahead, told)[:, ahead:]
            share = torch.from_numpy(token_share(x.shape[1], patch)).to(x.device)[:, None]
            x0 = other + share * (x0 - other)
        if told.goals is None or step < LAST:
            return x0
        way = self._pull(x0, lengths, told.goals)
        size = (way.square().sum((1, 2)) / (lengths * way.shape[2])).sqrt().clamp(min=1e-9)
        return x0 + (STRENGTH * told.guided / size)[:, None, None] * way

    def _pull(self, x0: Tensor, lengths: Tensor, goals: Tensor) -> Tensor:
        """See `ClassifierGuidance.gradients`; zero behind the motions' ends."""
        assert self.critic is not None
        mean, std = self.model.mean.float(), self.model.std.float()
        with torch.enable_grad():
            leaf = x0.detach().requires_grad_(True)
            cosines = (self.critic.motion(leaf * std + mean, lengths) * goals).sum() / RADIUS
            (gradient,) = torch.autograd.grad(cosines, leaf)
        gradient = gradient.clone()
        gradient[..., ROOT] = 0
        return smoothed(gradient, lengths)


def smoothed(values: Tensor, lengths: Tensor, spread: float = SPREAD) -> Tensor:
    """Values of rows in time, shape (B, N, D), convolved with a Gaussian of `spread` frames; each row's own ends are
    held, and zero follows.
    """
    reach = int(CUT * spread + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread) ** 2)
    at = torch.arange(values.shape[1], device=values.device)
    out = torch.zeros_like(values)
    for away, weight in zip(range(-reach, reach + 1), kernel / kernel.sum(), strict=True):
        places = torch.minimum((at + away).clamp(min=0), lengths[:, None] - 1)
        out += float(weight) * values.gather(1, places[..., None].expand(-1, -1, values.shape[2]))
    return out * (at < lengths[:, None])[..., None]
