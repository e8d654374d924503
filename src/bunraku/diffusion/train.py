"""Training of the denoiser (Eq. 6 and 9 of TapMo; the adaptation's own losses come with the mesh-specific learning).

A run folder holds `state.safetensors` (all that is needed to go on), `diffusion.safetensors` (the averaged weights, ready to
use), `log.csv` and the encoded captions. The same command goes on where a run stopped.
"""

from __future__ import annotations

import csv
import math
import queue
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch

from bunraku.diffusion.captions import caption_variants
from bunraku.diffusion.dataset import ClipSet, load_clips
from bunraku.diffusion.denoiser import PRESETS, DenoiserConfig
from bunraku.diffusion.features import FeatureStatistics
from bunraku.diffusion.text import TextEncoder, text_encoder
from bunraku.diffusion.textbank import TextBank
from bunraku.diffusion.trainer import Example, Trainer, TrainingConfig
from bunraku.errors import FormatError, OptionError
from bunraku.nn.checkpoints import load_training_state

__all__ = ["TrainingConfig", "train_diffusion"]


class _Stop:
    """Set by SIGTERM or Ctrl-C: finish the step, save, leave."""

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        def ask(number: int, frame: FrameType | None) -> None:
            self.asked = True

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, ask) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _statistics(path: Path) -> FeatureStatistics | None:
    """Units of a run that goes on: those it began with, also where clips have been added since; None for a new run."""
    if not path.is_file():
        return None
    model = load_training_state(path).models["model"]
    return FeatureStatistics(model["mean"].numpy(), model["std"].numpy())


def _mesh_bank(path: Path | None, size: int) -> np.ndarray | None:
    if path is None:
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            bank = np.asarray(file["features"], np.float32)
    except Exception as error:
        raise FormatError(path, f"the mesh features cannot be read ({error}); write them with 'bunraku train handles'") from error
    if bank.ndim != 2 or bank.shape[1] != size or not len(bank) or not np.isfinite(bank).all():
        raise FormatError(path, f"the mesh features must be finite numbers of shape (characters, {size}), not {bank.shape}")
    return bank


def _prefetch(clips: ClipSet, bank: TextBank, config: TrainingConfig, first: int, stop: threading.Event) -> queue.Queue[Any]:
    """Batches from `first` on, made one ahead by a thread."""
    ready: queue.Queue[Any] = queue.Queue(maxsize=3)

    def work() -> None:
        number = first
        try:
            while not stop.is_set():
                batch = clips.batch(config.seed, number, config.batch, config.compose)
                item = (number, batch, bank(batch.sentences))
                while not stop.is_set():
                    try:
                        ready.put(item, timeout=0.2)
                        break
                    except queue.Full:
                        continue
                number += 1
        except Exception as error:  # handed to the training loop
            ready.put(error)

    threading.Thread(target=work, daemon=True).start()
    return ready


def _sentences(clips: list[ClipSet]) -> list[str]:
    texts = {text for part in clips for clip in part.clips for text in clip.texts}
    return sorted({sentence for text in texts for mirrored in (False, True) for sentence in caption_variants(text, mirrored)})


def train_diffusion(config: TrainingConfig, network: DenoiserConfig | None = None, encoder: TextEncoder | None = None) -> Path:
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
    if (
        config.batch < 1
        or config.threads < 1
        or (config.minutes is not None and config.minutes <= 0)
        or (config.steps is not None and config.steps < 0)
    ):
        raise OptionError("batch, threads, minutes and steps must be positive")
    torch.set_num_threads(config.threads)
    config.out.mkdir(parents=True, exist_ok=True)
    console = Console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("clips", total=None)
        clips = load_clips(config.data, lambda done, total: bar.update(task, completed=done, total=total))
        training = [entry["features"] for entry in clips.values() if entry.get("split", "train") == "train"]
        statistics = _statistics(config.out / "state.safetensors") or FeatureStatistics.measure(training)
        frames = (network or PRESETS[config.preset]).frames
        train, val = (ClipSet(clips, statistics, split, frames) for split in ("train", "val"))
        del clips, training
        if encoder is None:
            encoder = text_encoder("clip" if config.text_folder else "all-MiniLM-L6-v2", config.text_folder)
        task = bar.add_task("captions", total=None)
        bank = TextBank(
            encoder, _sentences([train, val]), config.out / "captions.safetensors", lambda done, total: bar.update(task, completed=done, total=total)
        )
    if network is None:
        sizes = {"text_encoder": encoder.name, "text_size": encoder.token_size, "pooled_size": encoder.pooled_size}
        network = DenoiserConfig(**{**asdict(PRESETS[config.preset]), **sizes})
    trainer = Trainer(config, network, statistics, _mesh_bank(config.mesh_bank, network.mesh_features))
    state = config.out / "state.safetensors"
    if state.is_file():
        trainer.restore(state, network)
    examples = _validation(trainer, val, bank)
    console.print(
        f"{len(train.clips)} training and {len(val.clips)} validation clips, {len(bank)} sentences, "
        f"{sum(value.numel() for value in trainer.model.parameters()) / 1e6:.1f} M parameters, {trainer.device}, from step {trainer.step}"
    )
    torch.set_flush_denormal(True)  # tiny moments of the optimiser cost ten times their worth
    try:
        _loop(trainer, network, train, bank, examples, console)
    finally:
        torch.set_flush_denormal(False)
    return config.out / "diffusion.safetensors"


def _validation(trainer: Trainer, clips: ClipSet, bank: TextBank) -> list[Example]:
    """Fixed crops with fixed noise at fixed steps."""
    if len(clips.clips) < 2:
        return []
    examples = []
    for part in range(2):
        batch = clips.fixed(64, seed=part)
        example = trainer.example(batch, bank(batch.sentences), [1, part], train=False)
        example.step = torch.linspace(100, 950, len(batch.lengths)).long().to(trainer.device)
        examples.append(example)
    return examples


def _loop(trainer: Trainer, network: DenoiserConfig, clips: ClipSet, bank: TextBank, examples: list[Example], console: Any) -> None:
    config, stop, ended = trainer.config, _Stop(), threading.Event()
    log = config.out / "log.csv"
    fresh = not log.is_file()
    ready = _prefetch(clips, bank, config, trainer.step, ended)
    saved = last = time.monotonic()
    motions: list[float] = []
    velocities: list[float] = []
    begun, first = last, trainer.step
    with stop.listening(), log.open("a", newline="") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(["step", "seconds", "rate", "motion", "velocity", "validation", "validation_wrong_text", "steps_per_second"])
        try:
            while not stop.asked and trainer.progress() < 1:
                item = ready.get()
                if isinstance(item, Exception):
                    raise item
                number, batch, text = item
                motion, velocity = trainer.update(trainer.example(batch, text, [config.seed, number]))
                motions.append(motion)
                velocities.append(velocity)
                now = time.monotonic()
                trainer.seconds += now - last
                last = now
                if trainer.step % config.validate_every == 0 or trainer.step == first + 20:
                    right, wrong = trainer.validate(examples) if trainer.step % config.validate_every == 0 else (math.nan, math.nan)
                    speed = (trainer.step - first) / (now - begun)
                    row = [trainer.step, round(trainer.seconds), trainer.learning_rate(), np.mean(motions), np.mean(velocities), right, wrong, speed]
                    writer.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in row])
                    file.flush()
                    console.print(
                        f"step {trainer.step:6d}  {trainer.seconds / 60:6.1f} min  loss {row[3]:.4f} velocity {row[4]:.4f}  "
                        f"validation {right:.4f}, with wrong text {wrong:.4f}  {speed:.2f} steps/s"
                    )
                    motions, velocities = [], []
                if now - saved > 60 * config.save_every:
                    trainer.save(config.out, network)
                    saved = time.monotonic()
        finally:
            ended.set()
        trainer.save(config.out, network)
    console.print(f"saved {config.out} at step {trainer.step}" + ("; the same command goes on" if trainer.progress() < 1 else ""))
