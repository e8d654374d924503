"""What a student of few steps learns from: motions that the denoiser itself draws in many steps, seen at few of them.

A trajectory goes from noise to a motion by the sampler that users have (`teacher`). The student's steps are some of the
teacher's. At each the target is the x0 from which one step of DDIM leads to where the trajectory stands at the next one
(progressive distillation, Salimans & Ho 2022, on trajectories that are drawn and not on noised data), so the student
holds the guidance.

Some begin at a noised captured motion, as motions do that start from an example. Some begin where the student's own
steps have led, so that it learns to come back (DAgger, Ross et al. 2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.sampling.solvers import alphas_cumprod
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.few_steps.teacher import Teacher
from bunraku_lab.training.rows.drawn_rows import DrawnRows

__all__ = ["NODES", "STEPS", "Trajectories", "ddim", "draw_trajectories", "places", "visited_steps"]

STEPS = 20
"""Of the teacher."""
NODES = (0, 7, 11, 15)
"""Which of its steps are the student's. The third is below `LED_UNTIL`: down to there an example stands for what is
predicted.
"""
Roll = Callable[[DrawnRows, Tensor, int], Tensor]
"""The student's own way from x (B, N, D) at its first step down to a step of that number."""


def places(visited: Sequence[int]) -> np.ndarray:
    """How a step of DDIM from each visited step to the next mixes: the share of x_t and that of x0, shape (S, 2)."""
    curve = alphas_cumprod()
    alpha = [math.sqrt(curve[step]) for step in visited] + [1.0]
    sigma = [math.sqrt(1 - curve[step]) for step in visited] + [0.0]
    ratios = [after / before for before, after in zip(sigma, sigma[1:], strict=False)]
    return np.array([[r, after - before * r] for r, before, after in zip(ratios, alpha, alpha[1:], strict=False)])


def ddim(visited: Sequence[int], node: int, x: Tensor, x0: Tensor) -> Tensor:
    """x at the next node, from x at this one and what is predicted there."""
    own, clean = places(visited)[node]
    return float(own) * x + float(clean) * x0


def visited_steps(teacher: Teacher) -> tuple[int, ...]:
    """The student's diffusion steps, falling."""
    return tuple(teacher.steps[node] for node in NODES)


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Trajectories of a batch of rows.

    Args:
        rows: What they are told, without their motions, numbers in half precision.
        stations: Where they are at each of the student's steps from `start` on, and at their ends, shape (S + 1, B, N,
            D), float16.
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
        """What rows are told, where they are at nodes (B,), and where at the next, shape (B, N, D) each, float32."""
        here, there = (self.stations[nodes - self.start + later, rows].float() for later in (0, 1))
        return _wide(self.rows, rows), here, there


def draw_trajectories(
    teacher: Teacher, rows: DrawnRows, random: torch.Generator, start: int = 0, roll: Roll | None = None
) -> Trajectories:
    """The trajectories of a batch of rows.

    Args:
        teacher: Draws them.
        rows: Motions in network units, and what is told of them.
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
        rows,
        clean=rows.clean[:, :0],
        text=TextBatch(text.tokens.half(), text.mask, text.pooled),
        examples=None if found is None else RetrievedExamples(found.values.half(), found.lengths, found.pooled),
    )


def _wide(rows: DrawnRows, some: Tensor) -> DrawnRows:
    """Some of the rows, as networks read them."""
    text = TextBatch(rows.text.tokens[some].float(), rows.text.mask[some], rows.text.pooled[some])
    found = None if rows.examples is None else rows.examples.rows(some)
    return DrawnRows(
        rows.clean[some],
        rows.lengths[some],
        text,
        None if rows.mesh is None else rows.mesh[some],
        rows.known[some],
        rows.person[some],
        None if found is None else RetrievedExamples(found.values.float(), found.lengths, found.pooled),
    )
