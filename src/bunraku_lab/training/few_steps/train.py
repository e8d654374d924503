"""Distillation of the denoiser into few guided steps, as a low-rank change (Hu et al. 2022)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from bunraku.core.files import weights_file
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint, shipped_checkpoint
from bunraku.errors import OptionError
from bunraku.generation.denoiser import FEW_STEPS_KIND, fingerprint
from bunraku.generation.extractor import RANKER
from bunraku.generation.features import FeatureStatistics, feature_weights
from bunraku.generation.pack import load_examples
from bunraku.generation.retrieve import example_bank
from bunraku.language.encoders import CuedEncoder, TextEncoder, text_encoder
from bunraku_lab.nn.checkpoints import TrainingState
from bunraku_lab.nn.denoiser import Denoiser, load_denoiser
from bunraku_lab.nn.text import load_extractor
from bunraku_lab.training.few_steps.teacher import (
    STEPS,
    Teacher,
    Trajectories,
    ddim,
    ddim_shares,
    draw_trajectories,
    visited_steps,
)
from bunraku_lab.training.losses.motion import motion_losses
from bunraku_lab.training.rows.banks import TextBank, load_mesh_bank
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.clips import load_clips
from bunraku_lab.training.rows.workers import DrawnRows, FedPool, MadeRows, RowMaker, RowPool, RowWorkers
from bunraku_lab.training.runs.run import (
    AveragedRun,
    Progress,
    Report,
    StepSettings,
    TrainingNote,
    bf16_is_fast,
    forking,
)


class LowRank(nn.Module):
    """W + U D, where W (O, I) stays as it is.

    Args:
        matrix: W.
        rank: Columns of U and rows of D. U begins at zero, so the network says at first what it said.
    """

    def __init__(self, matrix: Tensor, rank: int):
        super().__init__()
        rows, columns = matrix.shape
        self.up = nn.Parameter(torch.zeros(rows, rank))
        self.down = nn.Parameter(torch.randn(rank, columns) * columns**-0.5)

    def forward(self, matrix: Tensor) -> Tensor:
        """The changed matrix."""
        return matrix + self.up @ self.down


def with_changes(model: nn.Module, rank: int, without: tuple[str, ...] = ()) -> nn.Module:
    """The model itself, where every linear layer has a change of at most this rank that learns, and nothing else.

    Args:
        model: Changed in place.
        rank: Of each change, less in smaller matrices.
        without: Layers by name that keep their matrices.
    """
    model.requires_grad_(False)
    for name, layer in list(model.named_modules()):
        weight = layer._parameters.get("weight")
        if weight is not None and weight.ndim == 2 and name not in without:
            change = LowRank(weight, min(rank, *weight.shape))
            parametrize.register_parametrization(layer, "weight", change)
    return model


def changes_of(model: nn.Module) -> dict[str, Tensor]:
    """U and D of each changed matrix, as "NAME.up" and "NAME.down"."""
    found = {}
    for name, layer in model.named_modules():
        if isinstance(layer, LowRank):
            matrix = name.replace(".parametrizations.weight.0", ".weight")
            found[f"{matrix}.up"], found[f"{matrix}.down"] = layer.up.detach(), layer.down.detach()
    return found


class RowSource(Protocol):
    """Rows with the examples that `animate` finds."""

    def __call__(self, number: int) -> DrawnRows:
        """Batch of that number."""
        ...

    def close(self) -> None:
        """End what makes rows."""
        ...


class RowsInTurn:
    """Rows made when they are asked for: a pure function of the maker's seed."""

    def __init__(self, maker: RowMaker, rows: int, frames: int, device: torch.device):
        self.maker, self.pool = maker, RowPool(rows, frames, device, maker.meshes)

    def __call__(self, number: int) -> DrawnRows:
        return self.of(self.maker(number, self.pool.size))

    def of(self, made: MadeRows) -> DrawnRows:
        """Made rows on the device, padded to the longest."""
        self.pool.added = 0
        self.pool.add(made)
        rows = self.pool.rows(torch.arange(len(self.pool), device=self.pool.device), nearest=True)
        return replace(rows, clean=rows.clean[:, : int(rows.lengths.max())])

    def close(self) -> None:
        """Nothing has to end."""


class PooledRows:
    """Rows from a pool on the device; a run that goes on fills it anew.

    Args:
        maker: Makes them.
        workers: Processes that do.
        rows: Of a batch.
        pool: Rows that are kept.
        frames: Longest row.
        device: Where they are wanted.
    """

    def __init__(self, maker: RowMaker, workers: int, rows: int, pool: int, frames: int, device: torch.device):
        self.size, self.seed = rows, maker.seed
        self.fed = FedPool(RowPool(pool, frames, device, maker.meshes), RowWorkers(maker, workers))

    def __call__(self, number: int) -> DrawnRows:
        self.fed.feed(self.size)
        random = torch.Generator(self.fed.pool.device).manual_seed(self.seed * 1_000_003 + number)
        return self.fed.pool.draw(self.size, random, nearest=True)

    def close(self) -> None:
        self.fed.close()


_BATCHES = 4
"""Of rows that are kept at the least, so that a step's lessons are not all of one kind of start."""
_HELD = 48
"""Rows of held-out clips that are validated on."""
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
        kept: Trajectories from which each batch is drawn, the newest.
        led: Share of trajectories that begin at noised captured motions.
        rolled: Share of trajectories that begin where the student's own steps have led.
        velocity_weight: Of the loss of differences from frame to frame.
        compose: Share of rows that join two or three clips.
        start: Changes of another distillation to start a new run from.
        workers: Processes that draw rows ahead into a pool on the device; 0 draws each batch when it is due.
        pool: Rows in it, the newest.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        bf16: Compute in bfloat16 where the device has it in hardware.
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
    kept: int = 1500
    led: float = 0.35
    rolled: float = 0.25
    batch: int = 32
    rate: float = 4e-4
    velocity_weight: float = 2.0
    compose: float = 0.1
    start: Path | None = None
    workers: int = 0
    pool: int = 50_000
    device: str | None = None
    bf16: bool = True
    least: ClassVar[dict[str, float]] = {
        **StepSettings.least, "rank": 1, "rows": 1, "uses": 0.1, "kept": 1, "workers": 0, "pool": 1,
    }  # fmt: skip


class FewStepsRun(AveragedRun[torch.nn.Module]):
    """One distillation in memory."""

    kind = FEW_STEPS_KIND
    config: FewStepsConfig

    def __init__(
        self, config: FewStepsConfig, diffusion: Path, teacher: Teacher, source: RowSource, held: DrawnRows | None
    ):
        self.config, self.diffusion, self.teacher, self.source = config, diffusion, teacher, source
        self.device, self.bf16 = teacher.model.mean.device, teacher.bf16
        self.set_up(
            lambda: with_changes(load_denoiser(diffusion).float(), config.rank, _KEPT).to(self.device), self._begin
        )
        self.visited = visited_steps(teacher)
        self.kept: deque[Trajectories] = deque(maxlen=max(_BATCHES, config.kept // config.rows))
        self.owed, self.drawn = 0.0, 0
        self.weights = torch.from_numpy(feature_weights()).to(self.device)
        self.places = torch.from_numpy(ddim_shares(self.visited).astype(np.float32)).to(self.device)
        self.held = None if held is None else draw_trajectories(teacher, held, self._noise(-1))
        self.held_out = [] if self.held is None else [self.held]

    def _begin(self, model: torch.nn.Module) -> None:
        """Give a new student the changes that the run starts from."""
        if self.config.start is None:
            return
        changes, _ = load_checkpoint(self.config.start, FEW_STEPS_KIND)
        own = {
            name.replace(".weight.", ".parametrizations.weight.0."): torch.from_numpy(value)
            for name, value in changes.items()
        }
        try:
            strange = model.load_state_dict(own, strict=False).unexpected_keys
        except RuntimeError as error:
            strange = [str(error).splitlines()[-1].strip()]
        if strange:
            raise OptionError(
                f"{self.config.start}: a run cannot start from these changes ({strange[0]}); give their rank"
            )

    def _noise(self, number: int) -> torch.Generator:
        seed = np.random.SeedSequence([self.config.seed, number + 1]).generate_state(1, np.uint64)[0]
        return torch.Generator(self.device).manual_seed(int(seed >> 1))

    def extras(self) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
        """Also how many batches were drawn: a run that goes on draws anew, from the next one on."""
        values, generators = super().extras()
        return {**values, "drawn": self.drawn}, generators

    def take_extras(self, state: TrainingState) -> None:
        """See `extras`."""
        super().take_extras(state)
        self.drawn = int(state.values["drawn"])

    def draw(self) -> None:
        """Trajectories of a further batch of rows."""
        config, random, nodes = self.config, self.rng, len(self.visited)
        rows, noise = self.source(self.drawn), self._noise(self.drawn)
        self.drawn += 1
        if random.random() < 0.5:
            rows = replace(rows, mesh=None)
        way = random.random()
        if way < config.led:
            found = draw_trajectories(self.teacher, rows, noise, nodes // 2)
        elif way < config.led + config.rolled and self.step:
            found = draw_trajectories(self.teacher, rows, noise, int(random.integers(1, nodes)), self.rolled)
        else:
            found = draw_trajectories(self.teacher, rows, noise)
        self.kept.append(found)
        self.owed += config.uses * found.lessons / config.batch

    @torch.no_grad()
    def rolled(self, rows: DrawnRows, x: Tensor, stop: int) -> Tensor:
        """The student's x (B, N, D) at a node, from noise."""
        for node in range(stop):
            nodes = torch.full((len(x),), node, device=self.device)
            x = ddim(self.visited, node, x, self._predict(self.average, rows, x, nodes))
        return x

    def _predict(self, model: torch.nn.Module, rows: DrawnRows, x: Tensor, nodes: Tensor) -> Tensor:
        """x0 (B, N, D) of rows that are at nodes (B,)."""
        assert isinstance(model, Denoiser)
        text, keep = rows.text, torch.ones_like(rows.known)
        known = rows.known if rows.mesh is not None else ~keep
        steps = torch.tensor(self.visited, device=self.device)[nodes]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            condition = model.condition(text.tokens, text.mask, text.pooled, rows.mesh, keep, known, rows.examples)
            predicted, _ = model(x, steps, rows.lengths, condition)
        return predicted.float()

    def _loss(self, model: torch.nn.Module, found: Trajectories, some: Tensor, nodes: Tensor) -> Tensor:
        """How far the student is from each target, by how much it counts at the next node, shape (B,)."""
        rows, here, there = found.some(some, nodes)
        longest = int(rows.lengths.max())
        here, there = here[:, :longest], there[:, :longest]
        own, clean = (part[:, None, None] for part in self.places[nodes].unbind(1))
        real = (torch.arange(longest, device=self.device) < rows.lengths[:, None])[..., None]
        target = (there - own * here) / clean * real
        predicted = self._predict(model, rows, here * real, nodes)
        place, change = motion_losses(predicted, target, rows.lengths, self.weights)
        return self.places[nodes, 1] * (place + self.config.velocity_weight * change)

    def step_loss(self) -> tuple[Tensor, dict[str, float]]:
        """The loss of the next batch of lessons, halves of which are of two batches of rows."""
        while self.owed < 1:
            self.draw()
        self.owed -= 1
        parts = []
        lessons = np.array([found.lessons for found in self.kept])  # each counts the same
        for size in (self.config.batch - self.config.batch // 2, self.config.batch // 2):
            found = self.kept[int(self.rng.choice(len(self.kept), p=lessons / lessons.sum()))]
            some = self.rng.integers(len(found), size=size)
            nodes = self.rng.integers(found.start, len(self.visited), size=size)
            if size:
                parts.append(self._loss(self.model, found, *(self._moved(part) for part in (some, nodes))))
        return torch.cat(parts).mean(), {"drawn": float(self.drawn)}

    def _moved(self, numbers: np.ndarray) -> Tensor:
        return torch.from_numpy(numbers).to(self.device)

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """The loss on trajectories of held-out sentences at each node, and how far the student's own steps end from the
        teacher's [network units, root of the mean square].
        """
        assert self.held is not None
        found: dict[str, float] = {}
        every = torch.arange(len(self.held), device=self.device)
        for node in range(len(self.visited)):
            found[f"node_{node}"] = float(
                self._loss(self.average, self.held, every, torch.full_like(every, node)).mean()
            )
        rows, x, _ = self.held.some(every, torch.zeros_like(every))
        x, ends = self.rolled(rows, x, len(self.visited)), self.held.stations[-1].float()
        real = torch.arange(x.shape[1], device=self.device) < rows.lengths[:, None]
        found["ends"] = float((x - ends)[real].square().mean().sqrt())
        found["spread"] = float(x[real].std() / ends[real].std())
        return found

    def write(self, note: TrainingNote) -> Path:
        """The averaged changes."""
        state, _ = load_checkpoint(self.diffusion, "diffusion", half=True)
        changes = {name: value.cpu().numpy() for name, value in changes_of(self.average).items()}
        config = {
            "of": fingerprint(state), "visited": list(self.visited), "guidance": self.teacher.guidance,
            "critic": self.teacher.critic is not None, "notes": dict(note),
        }  # fmt: skip
        return save_checkpoint(self.checkpoint, changes, config, FEW_STEPS_KIND, half=True)


def train_few_steps(
    config: FewStepsConfig, report: Report | None = None, progress: Progress | None = None,
    encoder: TextEncoder | None = None,
) -> Path:  # fmt: skip
    """Distil, or go on, and return the path of the changes.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another run.
        FormatError: The data are missing or damaged.
        WeightsError: The denoiser or the examples are missing or broken.
    """
    config.prepare()
    if config.led < 0 or config.rolled < 0 or config.led + config.rolled > 1:
        raise OptionError("led and rolled must be shares whose sum is at most 1")
    if config.workers:
        forking()
    diffusion = config.diffusion or shipped_checkpoint("diffusion")
    device = torch.device(config.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    model = load_denoiser(diffusion, device).float()
    critic = None
    if config.critic and weights_file("critic.safetensors").is_file():
        critic = load_extractor(shipped_checkpoint("critic"), device, RANKER).float()
        own, read = (one.config.text_encoder.removesuffix(CuedEncoder.SUFFIX) for one in (model, critic))
        if own != read or critic.config.pooled_size > model.config.pooled_size:
            raise OptionError(
                f"{diffusion}: its text encoder is not that of the critic, {critic.config.text_encoder}; leave the "
                "critic out with --no-critic"
            )
    bf16 = config.bf16 and bf16_is_fast(device)
    teacher = Teacher(model, critic, config.guidance, STEPS, bf16)

    def show_progress(done: int, total: int) -> None:
        if progress is not None:
            progress("clips", done / total)

    clips = load_clips(config.data, show_progress, splits={"train", "val"})
    statistics = FeatureStatistics(model.mean.cpu().numpy(), model.std.cpu().numpy())
    mixture = Mixture(balance=0.25, most_drawn=20)
    train, held = (ClipSet(clips, statistics, split, model.config.frames, mixture) for split in ("train", "val"))
    if not train.clips:
        raise OptionError(
            f"{config.data}: there are no training clips; build the data again with 'bunraku data motions'"
        )
    encoder = encoder or text_encoder(model.config.text_encoder)
    bank = None if config.mesh_bank is None else load_mesh_bank(config.mesh_bank, model.config.mesh_features)
    examples = example_bank(model.config, statistics, load_examples(), encoder) if model.config.examples else None
    maker = RowMaker(train, TextBank(encoder, []), config.seed, config.compose, bank, 0.0, examples)
    frames, rows = model.config.frames, None
    if len(held.clips) > 1:
        fixed = held.fixed(_HELD)
        made = replace(maker, clips=held).made(fixed, np.random.default_rng(2))
        rows = RowsInTurn(maker, len(fixed.lengths), frames, device).of(made)
    source: RowSource
    if config.workers:
        source = PooledRows(maker, config.workers, config.rows, config.pool, frames, device)
    else:
        source = RowsInTurn(replace(maker, bucket=4), config.rows, frames, device)
    try:
        return FewStepsRun(config, diffusion, teacher, source, rows).learn(report, progress)
    finally:
        source.close()
