"""Training of the denoiser (Eq. 6 of TapMo), and the card that says what the weights learned from."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch

from bunraku.core.files import atomic_write, remove_leftovers
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import OptionError, WeightsError
from bunraku.generation.denoiser import EXAMPLE_TOKENS, PRESETS, DenoiserConfig
from bunraku.generation.features import FeatureStatistics
from bunraku.generation.pack import ExamplePack, load_examples, read_pack
from bunraku.generation.retrieve import example_bank
from bunraku.language.encoders import MiniLMEncoder, TextEncoder, text_encoder
from bunraku_lab.datasets.motions.clips import credit_lines, read_bundle
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.denoiser import Denoiser, load_denoiser
from bunraku_lab.training.diffusion.trainer import (
    SHIPPED,
    BatchesAhead,
    BatchSource,
    Example,
    PooledBatches,
    Sources,
    Trainer,
    TrainingConfig,
)
from bunraku_lab.training.rows.banks import TextBank, load_mesh_bank
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.clips import ClipEntry, load_clips, rehearsal_clips
from bunraku_lab.training.runs.run import EventLog, Progress, Report, Stop, TrainingRun, forking, logged_columns

_HEAD = "adaptation_out."
_FREE = {"adaptation_mesh", "adaptation_frame", "examples"}
"""What may differ: the adaptation's layer is small and trained anew, and examples begin without effect."""


@torch.no_grad()
def rescaled(model: Denoiser, mean: torch.Tensor, std: torch.Tensor) -> dict[str, torch.Tensor]:
    """Weights that say of motions in other units what a denoiser says of them in its own.

    Network units are `(value - mean) / std`. The first and the last layer are linear in them, so the change of units
    goes into these two layers without loss: the same clean motion gives the same prediction. Noise, which has the same
    size in any units, does not.

    Args:
        model: The denoiser.
        mean: The new statistics, shape (D,).
        std: The same, shape (D,).

    Returns:
        A state for a denoiser of the same config.
    """
    state = {name: value.clone() for name, value in model.state_dict().items()}
    patch = model.config.frames_per_token
    scale, shift = ((std / model.std).float().repeat(patch), ((mean - model.mean) / model.std).float().repeat(patch))
    weight = state["motion_in.weight"].float()
    state["motion_in.bias"] = state["motion_in.bias"].float() + weight @ shift
    state["motion_in.weight"] = weight * scale
    state["motion_out.weight"] = state["motion_out.weight"].float() / scale[:, None]
    state["motion_out.bias"] = (state["motion_out.bias"].float() - shift) / scale
    state["mean"], state["std"] = mean.clone(), std.clone()
    return state


def start_from(path: str | Path, model: Denoiser) -> None:
    """Give a new denoiser the weights of a checkpoint, in its own units, but for the adaptation's layer.

    Args:
        path: A checkpoint of kind "diffusion".
        model: The new denoiser, its `mean` and `std` set.

    Raises:
        OptionError: The checkpoint is of another network.
        WeightsError: It is missing or broken.
    """
    old = load_denoiser(path)
    names = [field.name for field in fields(DenoiserConfig) if field.name not in _FREE]
    other = [name for name in names if getattr(old.config, name) != getattr(model.config, name)]
    if other:
        raise OptionError(
            f"{path}: a run cannot start from this network, whose {', '.join(other)} differ; give the preset that it "
            "was trained with"
        )
    state = rescaled(old, model.mean.cpu(), model.std.cpu())
    if model.config.examples and not old.config.examples:  # examples are read as motions are
        state["example_in.weight"] = state["motion_in.weight"].repeat(1, EXAMPLE_TOKENS) / EXAMPLE_TOKENS
        state["example_in.bias"] = state["motion_in.bias"].clone()
    kept = {name: value for name, value in state.items() if not name.startswith(_HEAD)}
    model.load_state_dict(kept, strict=False)


_CREDITS = "## Credits"


def training_card(clips: Mapping[str, ClipEntry], config: TrainingConfig) -> str:
    """A model card in Markdown.

    The terms of the weights that a run starts from hold for what comes out of it, so their credits are carried on.
    """
    learned = {name: entry for name, entry in clips.items() if entry.get("split", "train") == "train"}
    seconds: Counter[str] = Counter()
    for entry in learned.values():
        seconds[entry.get("licence") or "unknown"] += len(entry["features"]) / 20  # type: ignore[assignment]
    lines = [
        "# Model card",
        "",
        "The Shape-aware Motion Diffusion (section 3.2 of TapMo), trained with `bunraku train diffusion` on "
        f"{len(learned)} clips, {sum(seconds.values()) / 60:.1f} minutes.",
        "",
        "| licence of the clips | minutes |",
        "| --- | ---: |",
        *(f"| {licence} | {value / 60:.1f} |" for licence, value in seconds.most_common()),
        "",
    ]
    if config.start is not None:
        lines += [f"It went on from {config.start.name}, whose terms hold for it too.", ""]
    if config.rehearse:
        lines += [f"Of people's rows {config.rehearse:.0%} were captured examples that Bunraku brings.", ""]
    own = [f"{entry['credit']}. Licence: {entry['licence']}." for entry in learned.values() if entry.get("credit")]
    credits = list(dict.fromkeys([*credit_lines(learned), *own, *_carried(config)]))
    if credits:
        lines += [_CREDITS, "", *(f"- {line}" for line in credits), ""]
    return "\n".join(lines)


def _carried(config: TrainingConfig) -> list[str]:
    """The credits of the start weights and of the rehearsed examples, where their cards are beside them."""
    names = ["diffusion"] if config.start == SHIPPED else []
    names += ["examples"] if config.rehearse else []
    cards = [] if config.start in (None, SHIPPED) else [config.start.with_suffix(".md")]  # type: ignore[union-attr]
    for name in names:
        try:
            cards.append(shipped_checkpoint(name).with_suffix(".md"))
        except WeightsError:
            continue
    found = []
    for card in cards:
        if card.is_file():
            text = card.read_text(encoding="utf-8", errors="replace").partition(_CREDITS)[2]
            found += [line[2:].strip() for line in text.splitlines() if line.startswith("- ")]
    return found


def write_card(weights: Path, card: str) -> Path:
    """Write a card beside weights."""
    path = weights.with_suffix(".md")
    with atomic_write(path) as file:
        file.write(card.encode())
    return path


def _statistics(path: Path) -> FeatureStatistics | None:
    """Units of a run that goes on: those it began with, also where clips have been added since; None for a new run."""
    if not path.is_file():
        return None
    model = load_training_state(path).models["model"]
    return FeatureStatistics(model["mean"].numpy(), model["std"].numpy())


def _pack(config: TrainingConfig) -> ExamplePack:
    """The examples of a run."""
    pack = load_examples() if config.example_pack is None else read_pack(config.example_pack)
    if pack is None:
        raise WeightsError("the shipped examples are missing; install Bunraku again or name some with --example-pack")
    return pack


def train_diffusion(
    config: TrainingConfig, network: DenoiserConfig | None = None, encoder: TextEncoder | None = None,
    report: Report | None = None, progress: Progress | None = None,
) -> Path:  # fmt: skip
    """Train, or go on training, and return the path of the averaged weights.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another network.
        FormatError: The data are missing or damaged.
    """
    progress = progress or (lambda stage, done: None)
    if config.preset not in PRESETS:
        raise OptionError(f"the preset '{config.preset}' is unknown; choose one of: {', '.join(PRESETS)}")
    if config.batch < 1 or (config.minutes is not None and config.minutes <= 0) or (config.steps or 0) < 0:
        raise OptionError("batch, minutes and steps must be positive")
    if config.workers < 0 or (config.workers and config.pool < config.batch):
        raise OptionError("workers must be 0 or more, and the pool must hold a batch")
    if config.workers:
        forking()
    if not 0 <= config.rehearse < 1:
        raise OptionError(f"the share that is rehearsed must be 0 to below 1, not {config.rehearse:g}")
    shipped = load_denoiser(shipped_checkpoint("diffusion")) if config.start == SHIPPED else None
    config.prepare()
    remove_leftovers(config.out)
    clips = load_clips(config.data, lambda done, total: progress("clips", done / total))
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
    bank = TextBank(
        encoder, sorted({sentence for part in (train, val) for sentence in part.sentences()}),
        config.out / "captions.safetensors", lambda done, total: progress("captions", done / total),
        config.workers,
    )  # fmt: skip
    if network is None:
        sizes: dict[str, Any] = {
            "text_encoder": encoder.name, "text_size": encoder.token_size, "pooled_size": encoder.pooled_size,
        }  # fmt: skip
        network = replace(PRESETS[config.preset], **sizes, examples=config.examples)
    mesh_bank = config.mesh_bank
    if mesh_bank is None and config.data.is_file() and read_bundle(config.data).meshes is not None:
        mesh_bank = config.data
    meshes = None if mesh_bank is None else load_mesh_bank(mesh_bank, network.mesh_features)
    trainer = Trainer(config, network, statistics, meshes, notes)
    state = config.out / "state.safetensors"
    if state.is_file():
        trainer.restore(state, network)
    elif config.start is not None:
        start_from(config.start if shipped is None else shipped_checkpoint("diffusion"), trainer.model)
        trainer.average.load_state_dict(trainer.model.state_dict())
    sources = Sources(bank)
    if network.examples:
        sources = Sources(bank, example_bank(network, statistics, _pack(config), encoder))
    examples = _validation(trainer, val, sources)
    print(
        f"{len(train.clips)} training and {len(val.clips)} validation clips, {len(bank)} sentences, "
        f"{sum(value.numel() for value in trainer.model.parameters()) / 1e6:.1f} M parameters, {trainer.device}, "
        f"from step {trainer.step}"
    )
    source = (PooledBatches if config.workers else BatchesAhead)(trainer, train, sources)
    run = _Run(trainer, network, source, examples)
    try:
        path = run.learn(report, progress)
    finally:
        source.close()
    write_card(path, card)
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
    "steps_per_second",
)  # fmt: skip


class _Run(TrainingRun):
    """A trainer in the loop, with its batches, its validation and its log."""

    stage = "diffusion"
    columns = None
    flush = True

    def __init__(self, trainer: Trainer, network: DenoiserConfig, source: BatchSource, examples: list[Example]):
        self.trainer, self.network, self.source = trainer, network, source
        self.config, self.out, self.stop, self.held_out = trainer.config, trainer.config.out, Stop(), examples
        self.first = trainer.step
        self.begin = self.last = time.monotonic()
        log = self.out / "log.csv"
        if not log.is_file():
            log.write_text(",".join(_COLUMNS) + "\n", encoding="utf-8")
        self.log_columns = tuple(logged_columns(log))  # a run that goes on writes no other columns

    @property
    def checkpoint(self) -> Path:
        return self.out / "diffusion.safetensors"

    @property
    def ticks(self) -> int:
        """Steps."""
        return self.trainer.step

    @property
    def save_every(self) -> float:
        return max(float(self.config.save_every), 1e-9)

    def progress(self) -> float:
        """Share of the budget that is used up."""
        return self.trainer.progress()

    def train_step(self) -> dict[str, float]:
        """One step on the next batch, with the time since the one before."""
        trainer = self.trainer
        example = self.source.next()
        losses = trainer.update(example)
        now = time.monotonic()
        trainer.seconds += now - self.last
        self.last, self.step = now, trainer.step
        return losses

    def tells(self) -> bool:
        """Whether the log gets a row of this step: the first one comes early."""
        return self.trainer.step == self.first + 20

    def begun(self) -> dict[str, float]:
        """The first columns of a row of the log, and how fast it goes."""
        speed = (self.trainer.step - self.first) / (self.last - self.begin)
        return {
            "step": self.trainer.step, "seconds": round(self.trainer.seconds), "rate": self.trainer.learning_rate(),
            "steps_per_second": speed, "validation": math.nan, "validation_wrong_text": math.nan,
        }  # fmt: skip

    def event_log(self) -> EventLog:
        return EventLog(self.out / "events")

    def validate(self) -> dict[str, float]:
        """Loss with the right sentences and with those of other rows."""
        right, wrong = self.trainer.validate(list(self.held_out))
        return {"validation": right, "validation_wrong_text": wrong}

    def save(self, results: dict[str, float]) -> Path:
        """Write the state and the checkpoint."""
        self.trainer.save(self.out, self.network)
        return self.checkpoint
