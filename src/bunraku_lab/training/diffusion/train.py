"""Training of the denoiser (Eq. 6 to 9 of TapMo).

A run folder holds `state.safetensors` (all that is needed to go on), `diffusion.safetensors` (the averaged weights,
ready to use), `log.csv`, `events` (TensorBoard) and the encoded captions. The same command goes on where a run stopped.
Under `accelerate launch` several processes train together: each draws batches of its own, and the first one writes.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from bunraku.diffusion.denoiser_config import PRESETS, DenoiserConfig
from bunraku.diffusion.examples.attended import example_bank
from bunraku.diffusion.examples.pack import ExamplePack, load_examples, read_pack
from bunraku.diffusion.features import FeatureStatistics
from bunraku.errors import OptionError, WeightsError
from bunraku.formats.files import sweep
from bunraku.language.encoders import MiniLMEncoder, TextEncoder, text_encoder
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.datasets.characters.bank_file import load_character_bank
from bunraku_lab.datasets.motions.bundle import read_bundle
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser
from bunraku_lab.training.diffusion.batch_source import BatchesAhead, BatchSource, PooledBatches, Sources
from bunraku_lab.training.diffusion.card import training_card, write_card
from bunraku_lab.training.diffusion.config import SHIPPED
from bunraku_lab.training.diffusion.trainer import Example, Trainer, TrainingConfig
from bunraku_lab.training.diffusion.warm_start import start_from
from bunraku_lab.training.rows.clip_data import load_clips
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.mesh_bank import load_mesh_bank
from bunraku_lab.training.rows.rehearsal import rehearsal_clips
from bunraku_lab.training.rows.text_bank import TextBank
from bunraku_lab.training.runs.ahead import forking
from bunraku_lab.training.runs.events import EventLog
from bunraku_lab.training.runs.processes import open_processes
from bunraku_lab.training.runs.runs import Stop, logged_columns
from bunraku_lab.training.runs.training_run import TrainingRun

__all__ = ["TrainingConfig", "train_diffusion"]


def _statistics(path: Path) -> FeatureStatistics | None:
    """Units of a run that goes on: those it began with, also where clips have been added since; None for a new run."""
    if not path.is_file():
        return None
    model = load_training_state(path).models["model"]
    return FeatureStatistics(model["mean"].numpy(), model["std"].numpy())


def _pack(config: TrainingConfig) -> ExamplePack:
    """The examples of a run.

    Raises:
        WeightsError: They are missing or damaged.
    """
    pack = load_examples() if config.example_pack is None else read_pack(config.example_pack)
    if pack is None:
        raise WeightsError("the shipped examples are missing; install Bunraku again or name some with --example-pack")
    return pack


def _sentences(clips: list[ClipSet]) -> list[str]:
    return sorted({sentence for part in clips for sentence in part.sentences()})


def train_diffusion(
    config: TrainingConfig, network: DenoiserConfig | None = None, encoder: TextEncoder | None = None
) -> Path:
    """Train, or go on training, and return the path of the averaged weights.

    Args:
        config: The run.
        network: In place of the preset's network.
        encoder: In place of the built-in text encoder.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The data are missing or damaged.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    if config.preset not in PRESETS:
        raise OptionError(f"the preset '{config.preset}' is unknown; choose one of: {', '.join(PRESETS)}")
    if config.batch < 1 or (config.minutes is not None and config.minutes <= 0) or (config.steps or 0) < 0:
        raise OptionError("batch, minutes and steps must be positive")
    if config.workers < 0 or (config.workers and config.pool < config.batch):
        raise OptionError("workers must be 0 or more, and the pool must hold a batch")
    if config.workers:
        forking()
    if config.workers and config.character_bank is not None:
        raise OptionError(
            "the losses of --character-bank need batches that are drawn when they are due; leave out --workers"
        )
    if not 0 <= config.rehearse < 1:
        raise OptionError(f"the share that is rehearsed must be 0 to below 1, not {config.rehearse:g}")
    shipped = load_denoiser(shipped_checkpoint("diffusion")) if config.start == SHIPPED else None
    config.prepare()
    sweep(config.out)
    processes = open_processes(config.device)
    console = Console(quiet=not processes.main)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("clips", total=None)
        clips = load_clips(config.data, lambda done, total: bar.update(task, completed=done, total=total))
        card = training_card(clips, config)
        if config.rehearse:
            clips |= rehearsal_clips(_pack(config))
        training = [entry for entry in clips.values() if entry.get("split", "train") == "train"]
        measured = _statistics(config.out / "state.safetensors")
        if measured is None and shipped is not None:  # few clips say little of the units
            measured = FeatureStatistics(shipped.mean.numpy(), shipped.std.numpy())
        statistics = measured or FeatureStatistics.measure([entry["features"] for entry in training])
        notes: dict[str, object] = {"creatures": True} if any(entry.get("species") for entry in training) else {}
        network = network or (None if shipped is None else shipped.config)
        frames = (network or PRESETS[config.preset]).frames
        mixture = Mixture(
            config.creatures, config.computed, config.borrowed, config.events, config.balance, config.most_drawn,
            config.rehearse,
        )  # fmt: skip
        train, val = (ClipSet(clips, statistics, split, frames, mixture) for split in ("train", "val"))
        del clips, training
        if encoder is None:
            encoder = text_encoder(f"{'clip' if config.text_folder else MiniLMEncoder.name}+cues", config.text_folder)
        task = bar.add_task("captions", total=None)
        with processes.main_first():  # the others read what it has encoded
            bank = TextBank(
                encoder,
                _sentences([train, val]),
                config.out / "captions.safetensors",
                lambda done, total: bar.update(task, completed=done, total=total),
                config.workers,
            )
    if network is None:
        sizes: dict[str, Any] = {
            "text_encoder": encoder.name,
            "text_size": encoder.token_size,
            "pooled_size": encoder.pooled_size,
        }
        network = replace(
            PRESETS[config.preset],
            **sizes,
            adaptation_mesh=config.adaptation_mesh,
            examples=config.examples,
        )
    mesh_bank = config.mesh_bank
    if mesh_bank is None and config.data.is_file() and read_bundle(config.data).meshes is not None:
        mesh_bank = config.data
    meshes = None if mesh_bank is None else load_mesh_bank(mesh_bank, network.mesh_features)
    characters = None if config.character_bank is None else load_character_bank(config.character_bank)
    if characters is not None and characters.features.shape[1] != network.mesh_features:
        sizes_differ = f"its f_phi has {characters.features.shape[1]} numbers, not {network.mesh_features}"
        raise OptionError(
            f"{config.character_bank}: {sizes_differ}; write the bank again with 'bunraku data character-bank'"
        )
    trainer = Trainer(config, network, statistics, meshes, characters, processes, notes)
    state = config.out / "state.safetensors"
    if state.is_file():
        trainer.restore(state, network)
    elif config.start is not None:
        start_from(config.start if shipped is None else shipped_checkpoint("diffusion"), trainer.model)
        trainer.average.load_state_dict(trainer.model.state_dict())
    sources = Sources(bank)
    if network.examples:
        sources = Sources(bank, example_bank(network, statistics, _pack(config), encoder))
    examples = _validation(trainer, val, sources) if processes.main else []
    console.print(
        f"{len(train.clips)} training and {len(val.clips)} validation clips, {len(bank)} sentences, "
        f"{sum(value.numel() for value in trainer.model.parameters()) / 1e6:.1f} M parameters, {trainer.device}, "
        f"{processes.count} process{'es' if processes.count > 1 else ''}, from step {trainer.step}"
    )
    source = (PooledBatches if config.workers else BatchesAhead)(trainer, train, sources)
    run = _Run(trainer, network, source, examples, console)
    try:
        path = run.learn(run.tell)
    finally:
        source.close()
    if processes.main:
        write_card(path, card)
    console.print(
        f"saved {config.out} at step {trainer.step}" + ("; the same command goes on" if trainer.progress() < 1 else "")
    )
    processes.close()
    return path


def _validation(trainer: Trainer, clips: ClipSet, sources: Sources) -> list[Example]:
    """Fixed crops with fixed noise at fixed steps."""
    if len(clips.clips) < 2:
        return []
    examples = []
    for part in range(2):
        batch = clips.fixed(64, seed=part)
        text, found = sources(batch)
        example = trainer.example(batch, text, [1, part], train=False, examples=found)
        example.step = torch.linspace(100, 950, len(batch.lengths)).long().to(trainer.device)
        examples.append(example)
    return examples


_COLUMNS = (
    "step", "seconds", "rate", "motion", "velocity", "contact", "validation", "validation_wrong_text",
    "steps_per_second", "spring", "adversarial",
    "discriminator", "score",
)  # fmt: skip


class _Run(TrainingRun):
    """A trainer in the loop, with its batches, its validation and its log.

    Args:
        trainer: Networks and optimisers.
        network: The denoiser's config.
        source: Batches from the trainer's step on.
        examples: What is validated.
        console: Of rich.
    """

    stage = "diffusion"
    columns = None
    flush = True

    def __init__(
        self,
        trainer: Trainer,
        network: DenoiserConfig,
        source: BatchSource,
        examples: list[Example],
        console: Any,
    ):
        self.trainer, self.network, self.source, self.console = trainer, network, source, console
        self.config, self.out, self.stop, self.held_out = trainer.config, trainer.config.out, Stop(), examples
        self.main, self.first = trainer.processes.main, trainer.step
        self.begin = self.last = time.monotonic()
        log = self.out / "log.csv"
        if self.main and not log.is_file():
            log.write_text(",".join(_COLUMNS) + "\n", encoding="utf-8")
        if self.main:  # a run that goes on writes no other columns
            self.log_columns = tuple(logged_columns(log))

    @property
    def checkpoint(self) -> Path:
        """The averaged weights."""
        return self.out / "diffusion.safetensors"

    @property
    def ticks(self) -> int:
        """Steps."""
        return self.trainer.step

    @property
    def ended(self) -> bool:
        """Of several processes all stop after the same step, and so by what they told each other."""
        alone = self.trainer.processes.count == 1
        return self.trainer.stopped or (alone and self.stop.asked) or self.progress() >= 1

    @property
    def save_every(self) -> float:
        """Minutes between saved states."""
        return max(float(self.config.save_every), 1e-9)

    def progress(self) -> float:
        """Share of the budget that is used up."""
        return self.trainer.progress()

    def train_step(self) -> dict[str, float]:
        """One step on the next batch, with the time since the one before."""
        trainer = self.trainer
        example = self.source.next()
        trainer.asked = self.stop.asked
        told = trainer.update(example)
        now = time.monotonic()
        trainer.seconds += now - self.last
        self.last, self.step = now, trainer.step
        return told

    def due(self) -> bool:
        """Whether it is time to validate; the first process does."""
        return self.main and super().due()

    def tells(self) -> bool:
        """Whether the log gets a row of this step: the first one comes early."""
        return self.main and self.trainer.step == self.first + 20

    def begun(self) -> dict[str, float]:
        """The first columns of a row of the log, and how fast it goes."""
        speed = (self.trainer.step - self.first) / (self.last - self.begin)
        return {
            "step": self.trainer.step, "seconds": round(self.trainer.seconds), "rate": self.trainer.learning_rate(),
            "steps_per_second": speed, "validation": math.nan, "validation_wrong_text": math.nan,
        }  # fmt: skip

    def event_log(self) -> EventLog:
        """Where curves go."""
        return EventLog(self.out / "events" if self.main else None, self.console.print)

    def validate(self) -> dict[str, float]:
        """Loss with the right sentences and with those of other rows."""
        right, wrong = self.trainer.validate(list(self.held_out))
        return {"validation": right, "validation_wrong_text": wrong}

    def save(self, results: dict[str, float]) -> Path:
        """Write the state and the checkpoint; the first process does."""
        if self.main:
            self.trainer.save(self.out, self.network)
        return self.checkpoint

    def tell(self, row: dict[str, float]) -> None:
        """A row of the log to the terminal."""
        names = ("contact", "spring", "adversarial", "discriminator", "score")
        known = ""
        if math.isfinite(row["validation"]):
            known = f"validation {row['validation']:.4f}, with wrong text {row['validation_wrong_text']:.4f}  "
        extra = "  ".join(f"{name} {row[name]:.4f}" for name in names if name in row)
        self.console.print(
            f"step {self.trainer.step:6d}  {self.trainer.seconds / 60:6.1f} min  loss {row['motion']:.4f} velocity "
            f"{row['velocity']:.4f}  "
            f"{known}{extra}{'  ' if extra else ''}{row['steps_per_second']:.2f} steps/s"
        )
