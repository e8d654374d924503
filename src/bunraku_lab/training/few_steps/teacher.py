"""What a student of few steps learns from: the sampler, and the motions that it draws in many steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from bunraku.core.geometry.curves import CUT
from bunraku.core.nn.layers import Condition
from bunraku.generation.candidates import LAST, SPREAD, STRENGTH
from bunraku.generation.extractor import RADIUS, SHORTEST
from bunraku.generation.sampler import GUIDED_FROM, ROOT, alphas_cumprod, dpm_solver, sampling_steps, token_share
from bunraku_lab.nn.denoiser import Denoiser, RetrievedExamples
from bunraku_lab.nn.text import Extractor, TextBatch
from bunraku_lab.training.rows.workers import DrawnRows


class _Conditions(NamedTuple):
    """What does not depend on the step: conditions with and without the sentence, the critic's vectors of the sentences
    (B, E), and which rows it guides (B,).
    """

    sentence: Condition
    nothing: Condition
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
        conditions = self._conditions(rows)

        def predict(x: Any, step: int) -> Any:
            if seen is not None:
                seen(step, x)
            return self._predict(x, step, rows.lengths, conditions)

        return cast(Tensor, dpm_solver(predict, cast(Any, x), self.steps[start:]))

    @torch.no_grad()
    def _conditions(self, rows: DrawnRows) -> _Conditions:
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
        return _Conditions(sentence, nothing, goals, rows.person & (rows.lengths >= SHORTEST))

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.model.mean.device.type, torch.bfloat16, enabled=self.bf16)

    def _run(self, x: Tensor, step: int, lengths: Tensor, conditions: _Conditions) -> Tensor:
        """x0 as the sentence guides it, without the critic."""
        steps = torch.full((len(x),), step, device=x.device)
        with torch.no_grad(), self._precision():
            x0 = self.model(x, steps, lengths, conditions.sentence)[0].float()
            if step >= GUIDED_FROM and self.guidance != 1:
                unled = self.model(x, steps, lengths, conditions.nothing)[0].float()
                x0 = unled + self.guidance * (x0 - unled)
        return x0

    def _predict(self, x: Tensor, step: int, lengths: Tensor, conditions: _Conditions) -> Tensor:
        x0, patch = self._run(x, step, lengths, conditions), self.model.config.frames_per_token
        if step == self.steps[-1] and patch > 1:  # see `sampler._Group.predict`
            ahead = patch // 2
            moved = torch.cat([x[:, :ahead].flip(1), x], dim=1)
            other = self._run(moved, step, lengths + ahead, conditions)[:, ahead:]
            share = torch.from_numpy(token_share(x.shape[1], patch)).to(x.device)[:, None]
            x0 = other + share * (x0 - other)
        if conditions.goals is None or step < LAST:
            return x0
        way = self._pull(x0, lengths, conditions.goals)
        size = (way.square().sum((1, 2)) / (lengths * way.shape[2])).sqrt().clamp(min=1e-9)
        return x0 + (STRENGTH * conditions.guided / size)[:, None, None] * way

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
    """Values of rows in time, shape (B, N, D), convolved with a Gaussian of `spread` frames; ends are held."""
    reach = int(CUT * spread + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread) ** 2)
    at = torch.arange(values.shape[1], device=values.device)
    out = torch.zeros_like(values)
    for away, weight in zip(range(-reach, reach + 1), kernel / kernel.sum(), strict=True):
        places = torch.minimum((at + away).clamp(min=0), lengths[:, None] - 1)
        out += float(weight) * values.gather(1, places[..., None].expand(-1, -1, values.shape[2]))
    return out * (at < lengths[:, None])[..., None]


STEPS = 20
"""Of the teacher."""
NODES = (0, 7, 11, 15)
"""Which of its steps are the student's; the third is below `LED_UNTIL`."""
Roll = Callable[[DrawnRows, Tensor, int], Tensor]
"""The student's own way from x (B, N, D) at its first step down to a step of that number."""


def ddim_shares(visited: Sequence[int]) -> np.ndarray:
    """How a step of DDIM from each visited step to the next mixes: the share of x_t and that of x0, shape (S, 2)."""
    curve = alphas_cumprod()
    alpha = [math.sqrt(curve[step]) for step in visited] + [1.0]
    sigma = [math.sqrt(1 - curve[step]) for step in visited] + [0.0]
    ratios = [after / before for before, after in zip(sigma, sigma[1:], strict=False)]
    return np.array([[r, after - before * r] for r, before, after in zip(ratios, alpha, alpha[1:], strict=False)])


def ddim(visited: Sequence[int], node: int, x: Tensor, x0: Tensor) -> Tensor:
    """x at the next node, from x at this one and what is predicted there."""
    own, clean = ddim_shares(visited)[node]
    return float(own) * x + float(clean) * x0


def visited_steps(teacher: Teacher) -> tuple[int, ...]:
    """The student's diffusion steps, falling."""
    return tuple(teacher.steps[node] for node in NODES)


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Trajectories of a batch of rows.

    Args:
        rows: What they are conditions, without their motions, numbers in half precision.
        stations: The states at each of the student's steps from `start` on, and at the end, (S + 1, B, N, D), float16.
        start: The first of these steps.
    """

    rows: DrawnRows
    stations: Tensor
    start: int

    def __len__(self) -> int:
        return len(self.rows.lengths)

    @property
    def lessons(self) -> int:
        """How many steps of the student's they show."""
        return len(self) * (len(self.stations) - 1)

    def some(self, rows: Tensor, nodes: Tensor) -> tuple[DrawnRows, Tensor, Tensor]:
        """Rows, where they are at nodes (B,), and where at the next nodes, shape (B, N, D) each, float32."""
        here, there = (self.stations[nodes - self.start + later, rows].float() for later in (0, 1))
        return _wide(self.rows, rows), here, there


def draw_trajectories(
    teacher: Teacher, rows: DrawnRows, random: torch.Generator, start: int = 0, roll: Roll | None = None
) -> Trajectories:
    """The trajectories of a batch of rows.

    Args:
        teacher: Draws them.
        rows: Motions in network units, and their conditions.
        random: Draws the noise, on the rows' device.
        start: The student's step that the teacher begins at.
        roll: How the student gets there by itself; None noises the captured motions.
    """
    visited = visited_steps(teacher)
    noise = torch.randn(rows.clean.shape, generator=random, device=rows.clean.device)
    x = noise
    if start and roll is not None:
        x = roll(rows, noise, start)
    elif start:
        share = float(alphas_cumprod()[visited[start]])
        x = math.sqrt(share) * rows.clean + math.sqrt(1 - share) * noise
    stations: list[Tensor] = []

    def seen(step: int, x: Tensor) -> None:
        if step in visited:
            stations.append(x.half())

    stations.append(teacher(rows, x, NODES[start], seen).half())
    return Trajectories(_narrow(rows), torch.stack(stations), start)


def _narrow(rows: DrawnRows) -> DrawnRows:
    """Without motions, in half precision: many are kept."""
    text, found = rows.text, rows.examples
    return replace(
        rows, clean=rows.clean[:, :0], text=TextBatch(text.tokens.half(), text.mask, text.pooled),
        examples=None if found is None else RetrievedExamples(found.values.half(), found.lengths, found.pooled),
    )  # fmt: skip


def _wide(rows: DrawnRows, some: Tensor) -> DrawnRows:
    """Some of the rows, as networks read them."""
    text = TextBatch(rows.text.tokens[some].float(), rows.text.mask[some], rows.text.pooled[some])
    found = None if rows.examples is None else rows.examples.rows(some)
    return DrawnRows(
        rows.clean[some], rows.lengths[some], text, None if rows.mesh is None else rows.mesh[some], rows.known[some],
        rows.person[some],
        None if found is None else RetrievedExamples(found.values.float(), found.lengths, found.pooled),
    )  # fmt: skip
