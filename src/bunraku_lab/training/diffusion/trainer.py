"""One training run of the denoiser in memory, and where its batches come from."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import OptionError
from bunraku.generation.denoiser import TRAINING_STEPS, DenoiserConfig, denoiser_config
from bunraku.generation.features import FeatureStatistics, feature_weights
from bunraku.generation.retrieve import ExampleBank, take_of
from bunraku_lab.nn.checkpoints import TrainingState, load_training_state, save_training_state
from bunraku_lab.nn.denoiser import Denoiser, RetrievedExamples, add_noise, alphas_cumprod, save_denoiser
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.losses.motion import contact_loss, motion_losses
from bunraku_lab.training.rows.banks import MeshBank, TextBank
from bunraku_lab.training.rows.clip_rows import ClipSet, MotionBatch
from bunraku_lab.training.rows.workers import DrawnRows, FedPool, RowMaker, RowPool, RowWorkers
from bunraku_lab.training.runs.run import Ahead, RunSettings, bf16_is_fast, careful_step, follow_weights, learning_rate

SHIPPED = Path("shipped")
"""In place of a path: the weights that Bunraku brings."""


@dataclass(frozen=True, kw_only=True)
class TrainingConfig(RunSettings):
    """Settings of a training run.

    Args:
        data: Folder that `bunraku data motions` wrote, or the file that `bunraku data bundle` made of it.
        start: Weights to start a new run from, to go on with them on other data; "shipped" is the denoiser that Bunraku
            brings, with its sizes and units.
        rehearse: Share of people's rows that are captured examples which Bunraku brings, so that a network that goes on
            with few clips keeps what it knows.
        preset: "small" trains on a CPU, "paper" is TapMo's size.
        minutes: Stop after so many minutes of training, earlier sessions of the run included; None for no limit.
        steps: Stop after so many optimiser steps; None for no limit.
        learning_rate: Peak, after the warm-up.
        warmup: Steps of warm-up.
        decay: Share of the budget, at its end, over which the rate falls to a fiftieth.
        weight_decay: AdamW's.
        velocity_weight: Weight of the frame-difference term.
        contact_weight: Weight of the contact loss: feet that stand do not slide or lift.
        drop_text: Share of rows without their sentence, for classifier-free guidance.
        drop_mesh: Share of rows without their mesh feature.
        drop_tokens: Share of the text tokens that rows lack; the sentence's vector stays.
        drop_examples: Share of rows without the examples retrieved for them, where the network attends to examples.
        compose: Share of rows that join two clips, "a person walks and then waves".
        creatures: Share of rows that are creatures' clips, where the data have any.
        computed: Share of rows whose sentence is computed from the motion, where it says anything plain.
        borrowed: Share of people's rows with a creature's mesh, of actions that no clip of that creature shows.
        events: Share of people's rows that are plain to see in the numbers (a rotation, a punch), and described so.
        balance: Power of its clips by which an action is drawn: 1 as often as captured, 0 all actions alike.
        most_drawn: How many times as often as the median clip one is drawn at the most, so that the only one of its
            action is not learned by heart.
        ema: Decay of the averaged weights.
        mesh_bank: NPZ with `features` (C, 448), f_phi of many characters; None takes those of the bundle, where the
            data are one, else trains with the null mesh only.
        cross: Share of the people's motions that are given to any character of the banks, creatures too.
        examples: Captured examples that the network attends to, retrieved among `example_pack`; 0 trains without.
        example_pack: What `bunraku data examples` wrote; None takes the shipped examples.
        text_folder: Folder with CLIP, in place of the built-in text encoder.
        workers: Processes that draw rows ahead into a pool on the device; 0 draws each batch when it is due.
        pool: Rows in it, the newest. Each is learned from as often as the device is faster than the processes.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        bf16: Compute in bfloat16 where torch says it is safe and the device has it in hardware.
        save_every: Minutes between saved states.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/diffusion")
    start: Path | None = None
    rehearse: float = 0.0
    preset: str = "small"
    minutes: float | None = 60.0
    steps: int | None = None
    batch: int = 64
    learning_rate: float = 3e-4
    warmup: int = 300
    decay: float = 0.3
    weight_decay: float = 0.02
    velocity_weight: float = 2.0
    contact_weight: float = 0.02
    drop_text: float = 0.1
    drop_mesh: float = 0.2
    drop_tokens: float = 0.0
    drop_examples: float = 0.15
    compose: float = 0.12
    creatures: float = 0.25
    computed: float = 0.3
    borrowed: float = 0.1
    events: float = 0.15
    balance: float = 0.5
    most_drawn: float = math.inf
    ema: float = 0.999
    mesh_bank: Path | None = None
    cross: float = 0.1
    examples: int = 0
    example_pack: Path | None = None
    text_folder: Path | None = None
    workers: int = 0
    pool: int = 50_000
    device: str | None = None
    bf16: bool = True
    save_every: float = 5.0
    seed: int = 0


@dataclass
class Example:
    """A batch on its device, with its noise."""

    clean: Tensor
    noise: Tensor
    step: Tensor
    lengths: Tensor
    text: TextBatch
    mesh: Tensor | None
    keep_text: Tensor
    keep_mesh: Tensor
    of_body: Tensor
    examples: RetrievedExamples | None = None

    def to(self, device: torch.device) -> Example:
        """The same on a device."""
        moved: dict[str, Any] = {}
        for field in fields(self):
            part = getattr(self, field.name)
            moved[field.name] = part if part is None else part.to(device)
        return Example(**moved)


class Trainer:
    """Model, averaged model and optimiser of one run, and what is done with them at each step.

    Args:
        config: The run.
        network: The denoiser's config.
        statistics: Units of the network.
        mesh_bank: f_phi of many characters; None trains with the null mesh only.
        notes: What the checkpoint says of the run beside its own figures.
    """

    def __init__(
        self, config: TrainingConfig, network: DenoiserConfig, statistics: FeatureStatistics,
        mesh_bank: MeshBank | None = None, notes: Mapping[str, object] | None = None,
    ):  # fmt: skip
        self.config = config
        self.notes = notes or {}
        self.device = torch.device(config.device or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.manual_seed(config.seed)
        self.model = Denoiser(network).to(self.device)
        self.model.mean.copy_(torch.from_numpy(statistics.mean))
        self.model.std.copy_(torch.from_numpy(statistics.std))
        self.average = Denoiser(network).to(self.device).requires_grad_(False)
        self.average.load_state_dict(self.model.state_dict())
        decayed = [value for value in self.model.parameters() if value.ndim > 1]
        plain = [value for value in self.model.parameters() if value.ndim <= 1]
        groups = [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}]
        self.optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, betas=(0.9, 0.99), fused=True)
        self.bf16 = config.bf16 and bf16_is_fast(self.device)
        self.curve = alphas_cumprod().to(self.device)
        self.weights = torch.from_numpy(feature_weights()).to(self.device)
        self.mesh_bank = mesh_bank
        self.step = 0
        self.seconds = 0.0

    def example(
        self, batch: MotionBatch, text: TextBatch, seed: list[int], train: bool = True,
        examples: RetrievedExamples | None = None,
    ) -> Example:  # fmt: skip
        """Noise, steps, characters and dropped conditions for a batch: a pure function of the seed."""
        random = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] >> 1))
        size = len(batch.lengths)
        mesh, known, meshes = None, np.ones(size, bool), batch.meshes
        choice, cross = np.random.default_rng([*seed, 11]), self.config.cross if train else 0.0
        if self.mesh_bank is not None:
            mesh, known = self.mesh_bank.draw(meshes, size, choice, cross)
        rows = DrawnRows(
            torch.from_numpy(batch.values), torch.from_numpy(batch.lengths), text, mesh, torch.from_numpy(known),
            torch.tensor([name is None for name in meshes]), examples,
        )  # fmt: skip
        return self.noised(rows, random, train).to(self.device)

    def noised(self, rows: DrawnRows, random: torch.Generator, train: bool = True) -> Example:
        """Noise, steps and dropped conditions for rows, drawn on their device."""
        size, device, config = len(rows.lengths), rows.clean.device, self.config
        text, examples = rows.text, rows.examples
        noise = torch.randn(rows.clean.shape, generator=random, device=device)
        step = torch.randint(TRAINING_STEPS, (size,), generator=random, device=device)
        drop_text = torch.rand(size, generator=random, device=device) < (config.drop_text if train else -1)
        drop_mesh = torch.rand(size, generator=random, device=device) < (config.drop_mesh if train else 2)
        if train and config.drop_tokens:
            shown = torch.rand(text.mask.shape, generator=random, device=device) >= config.drop_tokens
            text = replace(text, mask=text.mask & shown)
        if train and examples is not None:
            shown = torch.rand(size, generator=random, device=device) >= config.drop_examples
            examples = replace(examples, lengths=examples.lengths * shown[:, None])
        keep_mesh = ~drop_mesh & rows.known
        return Example(
            rows.clean, noise, step, rows.lengths, text, rows.mesh, ~drop_text, keep_mesh, rows.person, examples
        )

    def predict(self, model: Denoiser, example: Example) -> tuple[Tensor, Tensor]:
        """x0 in network units and the adaptation from the noised motions, shapes (B, N, D) and (B, N, K, 3)."""
        noisy = add_noise(example.clean, example.noise, example.step, self.curve)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            text = example.text
            condition = model.condition(
                text.tokens, text.mask, text.pooled, example.mesh, example.keep_text, example.keep_mesh,
                example.examples,
            )  # fmt: skip
            predicted, adaptation = model(noisy, example.step, example.lengths, condition)
        return predicted, adaptation

    def losses(self, model: Denoiser, example: Example) -> tuple[Tensor, Tensor]:
        """Motion and velocity loss of each row, shape (B,) each."""
        return motion_losses(self.predict(model, example)[0], example.clean, example.lengths, self.weights)

    def progress(self) -> float:
        """Share of the budget that is used up, 0 to 1; 0 without a budget."""
        shares = [0.0]
        if self.config.minutes is not None:
            shares.append(self.seconds / max(60 * self.config.minutes, 1e-9))
        if self.config.steps is not None:
            shares.append(self.step / max(self.config.steps, 1))
        return max(shares)

    def learning_rate(self) -> float:
        """Warm-up, a plateau, and a cosine fall at the end of the budget."""
        config, used = self.config, self.progress()
        into = min(max((used - (1 - config.decay)) / max(config.decay, 1e-9), 0.0), 1.0)
        return learning_rate(config.learning_rate, self.step, config.warmup, into)

    def update(self, example: Example) -> dict[str, float]:
        """One optimiser step of L_m on a batch; the losses by name."""
        config = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate()
        predicted, _ = self.predict(self.model, example)
        motion, velocity = (
            part.mean() for part in motion_losses(predicted, example.clean, example.lengths, self.weights)
        )
        total = motion + config.velocity_weight * velocity
        reported = {"motion": motion, "velocity": velocity}
        if config.contact_weight > 0:
            found, true = (values * self.model.std + self.model.mean for values in (predicted.float(), example.clean))
            reported["contact"] = contact_loss(found, true, example.lengths, example.of_body).mean()
            total = total + config.contact_weight * reported["contact"]
        total.backward()
        careful_step(self.model, self.optimizer)
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        follow_weights(self.average, self.model, min(config.ema, (1 + self.step) / (10 + self.step)))
        return {name: float(value.detach()) for name, value in reported.items()}

    @torch.no_grad()
    def validate(self, examples: list[Example]) -> tuple[float, float]:
        """Mean motion loss of the averaged model on fixed noise, with the right sentences and with others."""
        right, wrong, rows = 0.0, 0.0, 0
        for example in examples:
            right += float(self.losses(self.average, example)[0].sum())
            text = example.text
            turned = TextBatch(text.tokens.roll(1, 0), text.mask.roll(1, 0), text.pooled.roll(1, 0))
            found = example.examples
            if found is not None:  # they are retrieved by the sentence
                found = found.rows(torch.arange(len(found.lengths), device=self.device).roll(1))
            wrong += float(self.losses(self.average, replace(example, text=turned, examples=found))[0].sum())
            rows += len(example.lengths)
        return right / max(rows, 1), wrong / max(rows, 1)

    def save(self, folder: Path, config: DenoiserConfig) -> None:
        """The state to go on from, then the averaged weights to use."""
        models = {"model": self.model.state_dict(), "average": self.average.state_dict()}
        optimizers = {"adamw": self.optimizer.state_dict()}
        settings = {"network": asdict(config), "run": {key: str(value) for key, value in asdict(self.config).items()}}
        state = TrainingState(self.step, models, optimizers, settings, {"seconds": self.seconds})
        save_training_state(folder / "state.safetensors", state)
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "batch": self.config.batch}
        known = 0 if self.mesh_bank is None else len(self.mesh_bank)
        save_denoiser(
            folder / "diffusion.safetensors",
            self.average,
            {**notes, "preset": self.config.preset, "characters": known, **self.notes},
        )

    def restore(self, path: Path, network: DenoiserConfig) -> None:
        """Go on from a saved state.

        Raises:
            OptionError: The run was started with another network.
        """
        state = load_training_state(path)
        if denoiser_config(state.config.get("network", {})) != network:  # an older state lacks newer fields
            raise OptionError(
                f"{path}: this run was started with another network; give the same preset and encoder, or another run "
                "folder"
            )
        self.model.load_state_dict(state.models["model"])
        self.average.load_state_dict(state.models["average"])
        self.optimizer.load_state_dict(state.optimizers["adamw"])
        self.step, self.seconds = state.step, float(state.values["seconds"])


@dataclass(frozen=True)
class Sources:
    """What rows get beside their motions: sentences encoded, and examples where the network attends to them."""

    text: TextBank
    examples: ExampleBank | None = None

    def __call__(self, batch: MotionBatch) -> tuple[TextBatch, RetrievedExamples | None]:
        text = self.text(batch.sentences)
        if self.examples is None:
            return text, None
        found = self.examples(text.arrays(), [{take_of(name) for name in own} for own in batch.clips])
        return text, RetrievedExamples(*map(torch.from_numpy, (found.values, found.lengths, found.pooled)))


class BatchSource(Protocol):
    """What a run learns from."""

    def next(self) -> Example:
        """The batch of the trainer's step."""
        ...

    def close(self) -> None:
        """End what makes batches."""
        ...


class BatchesAhead:
    """Batches from the trainer's step on, made ahead by a thread: a pure function of the seed."""

    def __init__(self, trainer: Trainer, clips: ClipSet, sources: Sources):
        self.trainer, self.clips, self.sources = trainer, clips, sources
        self._ahead = Ahead(self._made(trainer.step), 3)

    def _made(self, first: int) -> Iterator[tuple[int, MotionBatch, TextBatch, RetrievedExamples | None]]:
        config = self.trainer.config
        for number in itertools.count(first):
            batch = self.clips.batch(config.seed, number, config.batch, config.compose)
            yield number, batch, *self.sources(batch)

    def next(self) -> Example:
        number, batch, text, found = self._ahead.take()
        return self.trainer.example(batch, text, [self.trainer.config.seed, number], examples=found)

    def close(self) -> None:
        self._ahead.end()
        self._ahead.join()


class PooledBatches:
    """Batches from a pool on the trainer's device. A run that goes on fills it anew, so it does not learn from the very
    rows that it would have seen.
    """

    def __init__(self, trainer: Trainer, clips: ClipSet, sources: Sources):
        config, self.trainer = trainer.config, trainer
        maker = RowMaker(
            clips, sources.text, config.seed, config.compose, trainer.mesh_bank, config.cross, sources.examples
        )
        workers = RowWorkers(maker, config.workers, trainer.step)
        self._least = min(config.pool, 8 * config.batch)
        self.fed = FedPool(RowPool(config.pool, clips.frames, trainer.device, trainer.mesh_bank), workers)
        seed = np.random.SeedSequence([config.seed, trainer.step, 0]).generate_state(1, np.uint64)[0]
        self._random = torch.Generator(trainer.device).manual_seed(int(seed >> 1))

    def next(self) -> Example:
        self.fed.feed(self._least)
        return self.trainer.noised(self.fed.pool.draw(self.trainer.config.batch, self._random), self._random)

    def close(self) -> None:
        self.fed.close()
