"""Distillation of the denoiser into few steps: guidance by the sentence and by the critic in the weights.

What learns is a thin change of each matrix (`nn.diffusion.low_rank`), so the file is small and the denoiser keeps its
many steps. The lessons are drawn while the student learns (`trajectories`), and each is used some times.

A run folder holds `state.safetensors` (to go on from), `few-steps.safetensors` (the averaged changes) and `log.csv`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.features import FeatureStatistics, feature_weights
from bunraku.diffusion.inference.denoiser import load_denoiser as load_teacher
from bunraku.diffusion.inference.extractor import load_critic
from bunraku.diffusion.inference.few_steps import KIND, fingerprint
from bunraku.errors import OptionError
from bunraku.formats.files import weights_file
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku.nn.checkpoints import load_checkpoint, save_checkpoint, shipped_checkpoint
from bunraku_lab.nn.checkpoints import TrainingState
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.diffusion.low_rank import changes_of, with_changes
from bunraku_lab.training.diffusion.clip_data import load_clips
from bunraku_lab.training.diffusion.clip_rows import ClipSet, Mixture
from bunraku_lab.training.diffusion.mesh_bank import MeshBank, load_mesh_bank
from bunraku_lab.training.few_steps.trajectories import Lesson, Lessons, Told, ddim, places
from bunraku_lab.training.losses.motion_loss import motion_losses
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.half_precision import bf16_is_fast
from bunraku_lab.training.runs.settings import StepSettings
from bunraku_lab.training.runs.training_run import Progress, Report

__all__ = ["FewStepsConfig", "FewStepsRun", "train_few_steps"]

_KEPT = ("adaptation_out",)
"""Layers that keep their matrices: what the adaptation says is not learned from."""


@dataclass(frozen=True, kw_only=True)
class FewStepsConfig(StepSettings):
    """Settings of a distillation.

    Args:
        data: What `bunraku data motions` wrote: sentences, lengths and captured motions to start from.
        diffusion: The denoiser; None takes the shipped one.
        mesh_bank: f_phi of many characters; None learns for no mesh in particular.
        guidance: Scale of the guidance by sentences that the student holds.
        critic: Whether it holds the critic's pull, too.
        rank: Of the changes.
        rows: Trajectories that are drawn at once.
        uses: How many times a lesson is used, on the average.
        kept: Lessons from which each batch is drawn, the newest.
        led: Share of trajectories that begin at noised captured motions.
        rolled: Share of trajectories that begin where the student's own steps have led.
        velocity_weight: Of the loss of differences from frame to frame.
        compose: Share of rows that join two or three clips.
        bf16: Compute in bfloat16 where the processor has it in hardware.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/few-steps")
    diffusion: Path | None = None
    mesh_bank: Path | None = None
    guidance: float = 3.5
    critic: bool = True
    rank: int = 32
    rows: int = 32
    uses: float = 6.0
    kept: int = 6000
    led: float = 0.35
    rolled: float = 0.25
    batch: int = 32
    rate: float = 4e-4
    velocity_weight: float = 2.0
    compose: float = 0.1
    bf16: bool = True
    least: ClassVar[dict[str, float]] = {**StepSettings.least, "rank": 1, "rows": 1, "uses": 0.1, "kept": 64}


class FewStepsRun(AveragedRun[torch.nn.Module]):
    """One distillation in memory.

    Args:
        config: Settings.
        diffusion: Path of the teacher.
        lessons: Draws what is learned.
        clips: Rows to draw of, and those that are held out.
        bank: f_phi of many characters.
    """

    kind = KIND
    config: FewStepsConfig

    def __init__(
        self,
        config: FewStepsConfig,
        diffusion: Path,
        lessons: Lessons,
        clips: tuple[ClipSet, ClipSet],
        bank: MeshBank | None,
    ):
        self.config, self.diffusion, self.lessons, self.bank = config, diffusion, lessons, bank
        self.clips, held = clips
        self.set_up(lambda: with_changes(load_denoiser(diffusion), config.rank, _KEPT))
        self.kept: deque[Lesson] = deque(maxlen=config.kept)
        self.owed, self.drawn = 0.0, 0
        self.weights = torch.from_numpy(feature_weights())
        self.share = torch.from_numpy(places(lessons.visited)[:, 1].astype(np.float32))
        self.bf16 = config.bf16 and bf16_is_fast("cpu")
        self.held_out = []
        if len(held.clips) > 1:
            rows = held.fixed(48)
            self.held_out = lessons.draw(
                rows, self._meshes(rows.meshes, np.random.default_rng(2)), np.random.default_rng(3)
            )

    def _meshes(self, names: Sequence[str | None], random: np.random.Generator) -> np.ndarray | None:
        if self.bank is None:
            return None
        return self.bank.draw(names, len(names), random)[0].numpy()

    def extras(self) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
        """Also how many batches were drawn: who goes on draws lessons anew, from the next one on."""
        values, generators = super().extras()
        return {**values, "drawn": self.drawn}, generators

    def take_extras(self, state: TrainingState) -> None:
        """See `extras`."""
        super().take_extras(state)
        self.drawn = int(state.values["drawn"])

    def draw(self) -> None:
        """Trajectories of a further batch of rows."""
        config, random = self.config, self.rng
        batch = self.clips.batch(config.seed, self.drawn, config.rows, config.compose)
        self.drawn += 1
        known = self.bank is not None and random.random() < 0.5
        meshes = self._meshes(batch.meshes, random) if known else None
        way = random.random()
        nodes = len(self.lessons.visited)
        if way < config.led:
            found = self.lessons.draw(batch, meshes, random, nodes // 2)
        elif way < config.led + config.rolled and self.step:
            found = self.lessons.draw(batch, meshes, random, int(random.integers(1, nodes)), self.rolled)
        else:
            found = self.lessons.draw(batch, meshes, random)
        self.kept.extend(found)
        self.owed += config.uses * len(found) / config.batch

    @torch.no_grad()
    def rolled(self, noise: np.ndarray, lengths: np.ndarray, told: list[Told], stop: int) -> np.ndarray:
        """The student's x (B, N, D) at a node, from noise."""
        x = noise
        for node in range(stop):
            x0 = self._predict(self.average, x, lengths, np.full(len(x), node), told).numpy()
            x = ddim(self.lessons.visited, node, x, x0)
        return x

    def _predict(
        self, model: torch.nn.Module, x: np.ndarray, lengths: np.ndarray, nodes: np.ndarray, told: Sequence[Told]
    ) -> Tensor:
        """x0 (B, N, D) of rows that are at nodes (B,)."""
        text, found = _batched(told)
        known = np.array([one.mesh is not None for one in told])
        size = next((len(one.mesh) for one in told if one.mesh is not None), 1)
        mesh = np.stack([np.zeros(size, np.float32) if one.mesh is None else one.mesh for one in told])
        keep = torch.ones(len(told), dtype=torch.bool)
        steps = torch.tensor([self.lessons.visited[node] for node in nodes])
        assert isinstance(model, Denoiser)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            condition = model.condition(
                *text, torch.from_numpy(mesh) if known.any() else None, keep, torch.from_numpy(known), found
            )
            predicted, _ = model(torch.from_numpy(x), steps, torch.from_numpy(lengths), condition)
        return predicted.float()

    def _loss(self, model: torch.nn.Module, lessons: Sequence[Lesson]) -> Tensor:
        """How far the student is from each target, by how much it counts at the next node, shape (B,)."""
        lengths = np.array([len(one.noisy) for one in lessons])
        noisy, target = (_padded([getattr(one, name) for one in lessons], lengths) for name in ("noisy", "target"))
        nodes = np.array([one.node for one in lessons])
        predicted = self._predict(model, noisy, lengths, nodes, [one.told for one in lessons])
        place, change = motion_losses(predicted, torch.from_numpy(target), torch.from_numpy(lengths), self.weights)
        return self.share[torch.from_numpy(nodes)] * (place + self.config.velocity_weight * change)

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of the next batch of lessons."""
        while self.owed < 1:
            self.draw()
        self.owed -= 1
        size = self.config.batch
        chosen = self.rng.integers(len(self.kept), size=4 * size)
        some = sorted((self.kept[index] for index in chosen), key=lambda one: len(one.noisy))  # to pad little
        start = int(self.rng.integers(3 * size + 1))
        return self._loss(self.model, some[start : start + size]).mean(), {"drawn": float(self.drawn)}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """The loss on trajectories of held-out sentences at each node, and how far the student's own steps end from the
        teacher's [network units, root of the mean square].
        """
        found: dict[str, float] = {}
        for node in range(len(self.lessons.visited)):
            own = [one for one in self.held_out if one.node == node]
            found[f"node_{node}"] = float(self._loss(self.average, own).mean())
        first = [one for one in self.held_out if one.node == 0]
        last = [one for one in self.held_out if one.node == len(self.lessons.visited) - 1]
        lengths = np.array([len(one.noisy) for one in first])
        told = [one.told for one in first]
        x = self.rolled(_padded([one.noisy for one in first], lengths), lengths, told, len(self.lessons.visited))
        ends = _padded([one.target for one in last], lengths)
        real = np.arange(x.shape[1]) < lengths[:, None]
        found["ends"] = float(np.sqrt(np.square(x - ends)[real].mean()))
        found["spread"] = float(x[real].std() / ends[real].std())
        return found

    def write(self, note: TrainingNote) -> Path:
        """The averaged changes."""
        state, _ = load_checkpoint(self.diffusion, "diffusion", half=True)
        changes = {name: value.numpy() for name, value in changes_of(self.average).items()}
        config = {
            "of": fingerprint(state), "visited": list(self.lessons.visited), "guidance": self.lessons.guidance,
            "critic": self.lessons.critic is not None, "notes": dict(note),
        }  # fmt: skip
        return save_checkpoint(self.checkpoint, changes, config, KIND, half=True)


def _padded(parts: Sequence[np.ndarray], lengths: np.ndarray) -> np.ndarray:
    out = np.zeros((len(parts), int(lengths.max()), parts[0].shape[1]), np.float32)
    for row, part in zip(out, parts, strict=True):
        row[: len(part)] = part
    return out


def _batched(told: Sequence[Told]) -> tuple[tuple[Tensor, Tensor, Tensor], RetrievedExamples | None]:
    """Sentences and examples of rows side by side."""
    longest = max(one.text.mask.shape[1] for one in told)
    tokens = np.zeros((len(told), longest, told[0].text.tokens.shape[2]), np.float32)
    mask = np.zeros((len(told), longest), bool)
    for row, one in enumerate(told):
        size = one.text.mask.shape[1]
        tokens[row, :size], mask[row, :size] = one.text.tokens[0], one.text.mask[0]
    pooled = np.concatenate([one.text.pooled for one in told])
    text = torch.from_numpy(tokens), torch.from_numpy(mask), torch.from_numpy(pooled)
    found = [one.examples for one in told if one.examples is not None]
    if not found:
        return text, None
    frames = max(one.values.shape[2] for one in found)
    values = np.zeros((len(found), found[0].values.shape[1], frames, found[0].values.shape[3]), np.float32)
    for row, example in enumerate(found):
        values[row, :, : example.values.shape[2]] = example.values[0]
    parts = values, np.concatenate([one.lengths for one in found]), np.concatenate([one.pooled for one in found])
    return text, RetrievedExamples(*map(torch.from_numpy, parts))


def train_few_steps(
    config: FewStepsConfig,
    report: Report | None = None,
    progress: Progress | None = None,
    encoder: TextEncoder | None = None,
) -> Path:
    """Distil, or go on, and return the path of the changes.

    Args:
        config: The run.
        report: Called with each row of the log.
        progress: Called with a stage's name and the share done.
        encoder: In place of the denoiser's own text encoder.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another run.
        FormatError: The data are missing or damaged.
        WeightsError: The denoiser or the examples are missing or broken.
    """
    config.prepare()
    if config.led < 0 or config.rolled < 0 or config.led + config.rolled > 1:
        raise OptionError("led and rolled must be shares whose sum is at most 1")
    diffusion = config.diffusion or shipped_checkpoint("diffusion")
    teacher = load_teacher(diffusion)

    def told(done: int, total: int) -> None:
        if progress is not None:
            progress("clips", done / total)

    clips = load_clips(config.data, told, splits={"train", "val"})
    statistics = FeatureStatistics(teacher.mean, teacher.std)
    mixture = Mixture(balance=0.25, most_drawn=20)
    train, held = (ClipSet(clips, statistics, split, teacher.config.frames, mixture) for split in ("train", "val"))
    if not train.clips:
        raise OptionError(
            f"{config.data}: there are no training clips; build the data again with 'bunraku data motions'"
        )
    critic = load_critic() if config.critic and weights_file("critic.safetensors").is_file() else None
    lessons = Lessons(teacher, encoder or text_encoder(teacher.config.text_encoder), critic, config.guidance)
    bank = None if config.mesh_bank is None else load_mesh_bank(config.mesh_bank, teacher.config.mesh_features)
    return FewStepsRun(config, diffusion, lessons, (train, held), bank).learn(report, progress)
