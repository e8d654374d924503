"""What a student of few steps learns from: motions that the denoiser itself draws in many steps, seen at few of them.

A trajectory goes from noise to a motion by the sampler that users have, with guidance by the sentence and by the critic
at each step. The student's steps are some of those. At each the target is the x0 from which one step of DDIM leads to
where the trajectory stands at the next one (progressive distillation, Salimans & Ho 2022, on trajectories that are
drawn and not on noised data), so the student holds the guidance.

Some begin at a noised captured motion, as motions do that start from an example. Some begin where the student's own
steps have led, so that it learns to come back (DAgger, Ross et al. 2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.diffusion.examples.attended import example_bank
from bunraku.diffusion.extractor_config import RADIUS, SHORTEST
from bunraku.diffusion.features import FeatureStatistics
from bunraku.diffusion.inference.denoiser import Denoiser
from bunraku.diffusion.inference.examples import RetrievedExamples
from bunraku.diffusion.inference.extractor import Extractor, sentence_vectors
from bunraku.diffusion.sampling.classifier_guidance import ClassifierGuidance, Spoken
from bunraku.diffusion.sampling.sampler import Predictor, Solver, Steering, Window
from bunraku.diffusion.sampling.solvers import alphas_cumprod, dpm_solver, sampling_steps
from bunraku.language.encoders import TextBatch, TextEncoder, encoder_of
from bunraku_lab.training.diffusion.clip_rows import MotionBatch

__all__ = ["NODES", "STEPS", "Lesson", "Lessons", "Told", "ddim", "places"]

STEPS = 20
"""Of the teacher."""
NODES = (0, 7, 11, 15)
"""Which of its steps are the student's. The third is below `LED_UNTIL`: down to there an example stands for what is
predicted.
"""


@dataclass(frozen=True, eq=False)
class Told:
    """What a row is told beside its motion.

    Args:
        text: Its sentence, encoded, one row.
        mesh: f_phi, shape (448,); None for no mesh in particular.
        examples: What the network attends to, one row; None for none.
    """

    text: TextBatch
    mesh: np.ndarray | None
    examples: RetrievedExamples | None


@dataclass(frozen=True, eq=False)
class Lesson:
    """One step of the student's.

    Args:
        noisy: x_t in network units, shape (N, D), float16.
        target: The x0 that leads to the next node, shape (N, D), float16.
        node: Which of the student's steps, from 0.
        told: Of the row.
    """

    noisy: np.ndarray
    target: np.ndarray
    node: int
    told: Told


def places(visited: Sequence[int]) -> np.ndarray:
    """How a step of DDIM from each visited step to the next mixes: the share of x_t and that of x0, shape (S, 2)."""
    curve = alphas_cumprod()
    alpha = [math.sqrt(curve[step]) for step in visited] + [1.0]
    sigma = [math.sqrt(1 - curve[step]) for step in visited] + [0.0]
    ratios = [after / before for before, after in zip(sigma, sigma[1:], strict=False)]
    return np.array([[r, after - before * r] for r, before, after in zip(ratios, alpha, alpha[1:], strict=False)])


def ddim(visited: Sequence[int], node: int, x: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """x at the next node, from x at this one and what is predicted there."""
    own, clean = places(visited)[node].astype(np.float32)
    return np.asarray(own * x + clean * x0)


Roll = Callable[[np.ndarray, np.ndarray, list[Told], int], np.ndarray]


class Lessons:
    """Draws trajectories of a teacher.

    Args:
        teacher: The denoiser.
        encoder: Its text encoder.
        critic: What guides people's motions; None for nothing.
        guidance: Scale of the guidance by sentences.
    """

    def __init__(self, teacher: Denoiser, encoder: TextEncoder, critic: Extractor | None, guidance: float):
        self.teacher, self.encoder, self.critic, self.guidance = teacher, encoder, critic, guidance
        steps = sampling_steps(STEPS)
        self.steps, self.visited = steps, tuple(steps[node] for node in NODES)
        self.statistics = FeatureStatistics(teacher.mean, teacher.std)

    def told(self, batch: MotionBatch, meshes: np.ndarray | None) -> tuple[TextBatch, list[Told]]:
        """What the rows of a batch are told, together and one by one."""
        text = self.encoder.encode(batch.sentences)
        found = None
        if self.teacher.config.examples:
            found = example_bank(self.teacher.config, self.statistics)(text)
        rows = []
        for row in range(len(batch.lengths)):
            only = np.array([row])
            mesh = None if meshes is None else meshes[row]
            own = None if found is None else found.rows(only)
            if own is not None:  # many are kept
                own = replace(own, values=own.values[:, :, : own.lengths.max()].astype(np.float16))
            rows.append(Told(text.some([row]), mesh, own))
        return text, rows

    def draw(
        self,
        batch: MotionBatch,
        meshes: np.ndarray | None,
        random: np.random.Generator,
        start: int = 0,
        roll: Roll | None = None,
    ) -> list[Lesson]:
        """The lessons of a batch of rows.

        Args:
            batch: Motions in network units, and sentences.
            meshes: f_phi of each row's character, shape (B, 448); None for no mesh in particular.
            random: Draws the noise.
            start: The student's step that the teacher begins at.
            roll: The student's own way from the first step down to this one: x, lengths, what the rows are told, and
                the step; None noises the captured motions.
        """
        text, told = self.told(batch, meshes)
        rows, longest, size = batch.values.shape
        noise = random.standard_normal((rows, longest, size), np.float32)
        x = noise
        if start and roll is not None:
            x = roll(noise, batch.lengths, told, start)
        elif start:
            share = alphas_cumprod()[self.visited[start]]
            x = np.float32(math.sqrt(share)) * batch.values + np.float32(math.sqrt(1 - share)) * noise
        seen: dict[int, np.ndarray] = {}
        ends = self._run(batch, text, meshes, x.reshape(rows * longest, size), start, seen)
        stations = [seen[step].reshape(x.shape) for step in self.visited[start:]] + [ends.reshape(x.shape)]
        lessons = []
        for node, (here, there) in enumerate(zip(stations, stations[1:], strict=False), start):
            own, clean = places(self.visited)[node].astype(np.float32)
            target = (there - own * here) / clean
            for row, length in enumerate(batch.lengths):
                noisy, aim = (part[row, :length].astype(np.float16) for part in (here, target))
                lessons.append(Lesson(noisy, aim, node, told[row]))
        return lessons

    def _run(
        self,
        batch: MotionBatch,
        text: TextBatch,
        meshes: np.ndarray | None,
        x: np.ndarray,
        start: int,
        seen: dict[int, np.ndarray],
    ) -> np.ndarray:
        """The teacher's motions (F, D) from x (F, D) at a node; `seen` gets x at each node."""
        longest = batch.values.shape[1]
        bounds = [(row * longest, row * longest + int(length)) for row, length in enumerate(batch.lengths)]
        windows = [
            Window(np.arange(*bound), np.ones(bound[1] - bound[0], np.float32), row) for row, bound in enumerate(bounds)
        ]
        steering = Steering(self._critic(batch, text, bounds))
        solver = Solver(STEPS, self.guidance)
        predictor = Predictor(self.teacher, text, windows, len(x), solver, steering, meshes)

        def predict(x: np.ndarray, step: int) -> np.ndarray:
            if step in self.visited:
                seen[step] = x
            return predictor(x, step)

        return dpm_solver(predict, x, self.steps[NODES[start] :])

    def _critic(
        self, batch: MotionBatch, text: TextBatch, bounds: Sequence[tuple[int, int]]
    ) -> ClassifierGuidance | None:
        """The pull of people's motions towards their sentences."""
        if self.critic is None:
            return None
        encoder = encoder_of(self.critic.config.text_encoder, self.encoder)
        if encoder is not self.encoder:
            text = encoder.encode(batch.sentences)
        vectors = sentence_vectors(self.critic, text) / RADIUS
        stretches = [
            Spoken(bound, vectors[row])
            for row, bound in enumerate(bounds)
            if batch.meshes[row] is None and bound[1] - bound[0] >= SHORTEST
        ]
        return ClassifierGuidance(self.critic, self.teacher.mean, self.teacher.std, stretches)
