"""One training run of the denoiser in memory: model, averaged model, optimiser, and a step of each kind."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.dataset import MotionBatch
from bunraku.diffusion.denoiser import Denoiser, DenoiserConfig, save_denoiser
from bunraku.diffusion.features import FeatureStatistics, feature_weights
from bunraku.diffusion.losses import motion_losses
from bunraku.diffusion.schedule import TRAINING_STEPS, add_noise, alphas_cumprod
from bunraku.diffusion.text import TextBatch
from bunraku.errors import OptionError
from bunraku.nn.checkpoints import TrainingState, load_training_state, save_training_state

__all__ = ["Example", "Trainer", "TrainingConfig"]


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a training run.

    Args:
        data: Folder that `bunraku data motions` wrote.
        out: Run folder; the same folder goes on with the same run.
        preset: "small" trains on a CPU, "paper" is TapMo's size.
        minutes: Stop after so many minutes of training, earlier sessions of the run included; None for no limit.
        steps: Stop after so many optimiser steps; None for no limit.
        batch: Clips a step.
        learning_rate: Peak, after the warm-up.
        warmup: Steps of warm-up.
        decay: Share of the budget, at its end, over which the rate falls to a fiftieth.
        weight_decay: AdamW's.
        velocity_weight: Weight of the frame-difference term.
        drop_text: Share of rows without their sentence, for classifier-free guidance.
        drop_mesh: Share of rows without their mesh feature.
        compose: Share of rows that join two clips, "a person walks and then waves".
        ema: Decay of the averaged weights.
        mesh_bank: NPZ with `features` (C, 448), f_phi of many characters; None trains with the null mesh only.
        text_folder: Folder with CLIP, in place of the built-in text encoder.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        threads: CPU threads of torch.
        bf16: Compute in bfloat16 where torch says it is safe.
        save_every: Minutes between saved states.
        validate_every: Steps between validations.
        seed: Of everything random.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/diffusion")
    preset: str = "small"
    minutes: float | None = 60.0
    steps: int | None = None
    batch: int = 64
    learning_rate: float = 3e-4
    warmup: int = 300
    decay: float = 0.3
    weight_decay: float = 0.02
    velocity_weight: float = 2.0
    drop_text: float = 0.1
    drop_mesh: float = 0.2
    compose: float = 0.12
    ema: float = 0.999
    mesh_bank: Path | None = None
    text_folder: Path | None = None
    device: str | None = None
    threads: int = 1
    bf16: bool = True
    save_every: float = 5.0
    validate_every: int = 250
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


class Trainer:
    """Model, averaged model and optimiser of one run, and what is done with them at each step."""

    def __init__(self, config: TrainingConfig, network: DenoiserConfig, statistics: FeatureStatistics, mesh_bank: np.ndarray | None = None):
        self.config = config
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
        self.curve = alphas_cumprod().to(self.device)
        self.weights = torch.from_numpy(feature_weights()).to(self.device)
        self.mesh_bank = None if mesh_bank is None else torch.from_numpy(mesh_bank)
        self.step = 0
        self.seconds = 0.0

    def example(self, batch: MotionBatch, text: TextBatch, seed: list[int], train: bool = True) -> Example:
        """Noise, steps and dropped conditions for a batch: a pure function of the seed."""
        random = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] >> 1))
        size = len(batch.lengths)
        clean = torch.from_numpy(batch.values)
        noise = torch.randn(clean.shape, generator=random)
        step = torch.randint(TRAINING_STEPS, (size,), generator=random)
        drop_text = torch.rand(size, generator=random) < (self.config.drop_text if train else -1)
        drop_mesh = torch.rand(size, generator=random) < (self.config.drop_mesh if train else 2)
        mesh = None
        if self.mesh_bank is not None:
            mesh = self.mesh_bank[torch.randint(len(self.mesh_bank), (size,), generator=random)].to(self.device)
        return Example(
            clean.to(self.device), noise.to(self.device), step.to(self.device), torch.from_numpy(batch.lengths).to(self.device),
            text.to(self.device), mesh, ~drop_text.to(self.device), ~drop_mesh.to(self.device),
        )  # fmt: skip

    def losses(self, model: Denoiser, example: Example) -> tuple[Tensor, Tensor]:
        """Motion and velocity loss of each row, shape (B,) each."""
        noisy = add_noise(example.clean, example.noise, example.step, self.curve)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bf16):
            text = example.text
            condition = model.condition(text.tokens, text.mask, text.pooled, example.mesh, example.keep_text, example.keep_mesh)
            predicted, _ = model(noisy, example.step, example.lengths, condition)
        return motion_losses(predicted, example.clean, example.lengths, self.weights)

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
        warm = min(1.0, (self.step + 1) / max(config.warmup, 1))
        into = min(max((used - (1 - config.decay)) / max(config.decay, 1e-9), 0.0), 1.0)
        return config.learning_rate * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * into)))

    def update(self, example: Example) -> tuple[float, float]:
        """One optimiser step; the two losses."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate()
        motion, velocity = (part.mean() for part in self.losses(self.model, example))
        (motion + self.config.velocity_weight * velocity).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        if bool(torch.isfinite(norm)):
            self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.model.parameters()), 1 - decay)
        return float(motion.detach()), float(velocity.detach())

    @torch.no_grad()
    def validate(self, examples: list[Example]) -> tuple[float, float]:
        """Mean motion loss of the averaged model on fixed noise, with the right sentences and with those of other rows."""
        right, wrong, rows = 0.0, 0.0, 0
        for example in examples:
            right += float(self.losses(self.average, example)[0].sum())
            text = example.text
            turned = TextBatch(text.tokens.roll(1, 0), text.mask.roll(1, 0), text.pooled.roll(1, 0))
            wrong += float(self.losses(self.average, Example(**{**vars(example), "text": turned}))[0].sum())
            rows += len(example.lengths)
        return right / max(rows, 1), wrong / max(rows, 1)

    def save(self, folder: Path, config: DenoiserConfig) -> None:
        """The state to go on from, then the averaged weights to use."""
        state = TrainingState(
            self.step,
            {"model": self.model.state_dict(), "average": self.average.state_dict()},
            {"adamw": self.optimizer.state_dict()},
            {"network": asdict(config), "run": {key: str(value) for key, value in asdict(self.config).items()}},
            {"seconds": self.seconds},
        )
        save_training_state(folder / "state.safetensors", state)
        notes = {"steps": self.step, "minutes": round(self.seconds / 60, 1), "batch": self.config.batch, "preset": self.config.preset}
        notes["characters"] = 0 if self.mesh_bank is None else len(self.mesh_bank)
        save_denoiser(folder / "diffusion.safetensors", self.average, notes)

    def restore(self, path: Path, network: DenoiserConfig) -> None:
        """Go on from a saved state.

        Raises:
            OptionError: The run was started with another network.
        """
        state = load_training_state(path)
        if state.config.get("network") != asdict(network):
            raise OptionError(f"{path}: this run was started with another network; give the same preset and encoder, or another run folder")
        self.model.load_state_dict(state.models["model"])
        self.average.load_state_dict(state.models["average"])
        self.optimizer.load_state_dict(state.optimizers["adamw"])
        self.step, self.seconds = state.step, float(state.values["seconds"])
