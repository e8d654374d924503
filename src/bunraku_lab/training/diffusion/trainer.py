"""One training run of the denoiser in memory: model, averaged model, optimiser, and a step of each kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.denoiser_config import TRAINING_STEPS, DenoiserConfig, denoiser_config
from bunraku.diffusion.features import FeatureStatistics, feature_weights
from bunraku.errors import OptionError
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.nn.checkpoints import TrainingState, load_training_state, save_training_state
from bunraku_lab.nn.diffusion.checkpoint import save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.diffusion.noise import add_noise, alphas_cumprod
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.diffusion.config import TrainingConfig
from bunraku_lab.training.diffusion.mesh_learning import MeshDraw, MeshLearning
from bunraku_lab.training.losses.contact_loss import contact_loss
from bunraku_lab.training.losses.motion_loss import motion_losses
from bunraku_lab.training.rows.clip_rows import MotionBatch
from bunraku_lab.training.rows.drawn_rows import DrawnRows
from bunraku_lab.training.rows.mesh_bank import MeshBank
from bunraku_lab.training.runs.half_precision import bf16_is_fast
from bunraku_lab.training.runs.processes import Processes
from bunraku_lab.training.runs.runs import careful_step, follow_weights, learning_rate

__all__ = ["Example", "Trainer", "TrainingConfig"]


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
    draw: MeshDraw | None = None
    examples: RetrievedExamples | None = None

    def to(self, device: torch.device) -> Example:
        """The same on a device; what is drawn of characters lies on its own."""
        moved: dict[str, Any] = {}
        for field in fields(self):
            part = getattr(self, field.name)
            moved[field.name] = part if part is None or field.name == "draw" else part.to(device)
        return Example(**moved)


class Trainer:
    """Model, averaged model and optimiser of one run, and what is done with them at each step.

    Args:
        config: The run.
        network: The denoiser's config.
        statistics: Units of the network.
        mesh_bank: f_phi of many characters; None trains with the null mesh only.
        character_bank: Characters for the spring and the adversarial loss; None trains without them.
        processes: The processes that train together; this one alone when None.
        notes: What the checkpoint says of the run beside its own figures.
    """

    def __init__(
        self,
        config: TrainingConfig,
        network: DenoiserConfig,
        statistics: FeatureStatistics,
        mesh_bank: MeshBank | None = None,
        character_bank: CharacterBank | None = None,
        processes: Processes | None = None,
        notes: Mapping[str, object] | None = None,
    ):
        self.config = config
        self.processes = processes or Processes()
        self.notes = notes or {}
        self.device = self.processes.device or torch.device(
            config.device or ("cuda" if torch.cuda.is_available() else "cpu")
        )
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
        self.learning: MeshLearning | None = None
        if character_bank is not None:
            self.learning = MeshLearning(
                character_bank, self.device, config.characters, config.character_frames, config.sigma
            )
        self.step = 0
        self.seconds = 0.0
        self.asked = False  # this process was asked to stop
        self.stopped = False  # some process was, before the last step

    def example(
        self,
        batch: MotionBatch,
        text: TextBatch,
        seed: list[int],
        train: bool = True,
        examples: RetrievedExamples | None = None,
    ) -> Example:
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
        example = self.noised(rows, random, train)
        if self.learning is not None and train:
            example.draw = draw = self.learning.draw(choice, batch.lengths, meshes, cross)
            if draw is not None:
                bank, drawn = self.learning.bank, draw.rows.cpu()
                own = torch.zeros(size, bank.features.shape[1]) if mesh is None else mesh.clone()
                own[drawn] = bank.features[draw.characters].cpu()
                example.keep_mesh &= mesh is not None
                example.keep_mesh[drawn] = True
                example.mesh = own
        return example.to(self.device)

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
            rows.clean, noise, step, rows.lengths, text, rows.mesh, ~drop_text, keep_mesh, rows.person, None, examples
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
        """One optimiser step of L_m + nu_h L_h + nu_a L_a [TapMo 9] on the batch of this process; the losses by name,
        means over all processes.
        """
        config, learning = self.config, self.learning
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate()
        predicted, adaptation = self.predict(self.model, example)
        motion, velocity = (
            part.mean() for part in motion_losses(predicted, example.clean, example.lengths, self.weights)
        )
        total = motion + config.velocity_weight * velocity
        reported = {"motion": motion, "velocity": velocity}
        if config.contact_weight > 0:
            found, true = (values * self.model.std + self.model.mean for values in (predicted.float(), example.clean))
            reported["contact"] = contact_loss(found, true, example.lengths, example.of_body).mean()
            total = total + config.contact_weight * reported["contact"]
        samples, learns = None, learning is not None and learning.learns
        if learning is not None and example.draw is not None:
            clean = example.clean * self.model.std + self.model.mean
            spring, adversarial, *samples = learning.losses(example.draw, clean, adaptation, learns)
            total = total + config.spring_weight * spring + config.adversarial_weight * adversarial
            reported |= {"spring": spring, "adversarial": adversarial}
        total.backward()
        score = 0.0
        if learning is not None and samples is not None:
            reported["discriminator"], score = learning.learn(samples[0], samples[1], learns)
        numbers = [self.seconds, float(self.asked), score, *(float(value.detach()) for value in reported.values())]
        self.seconds, stops, score, *means = self.processes.mean(self._gradients(learns), *numbers)
        self.stopped = stops > 0
        self._step(learns and samples is not None)
        if learning is not None and samples is not None:
            learning.score = score
        return dict(zip(reported, means, strict=True)) | ({"score": score} if samples is not None else {})

    def _gradients(self, learns: bool) -> list[Tensor]:
        """Gradients of all that learns, for the exchange between processes."""
        if self.processes.count == 1:
            return []
        values = list(self.model.parameters())
        if learns and self.learning is not None:
            values += list(self.learning.discriminator.parameters())
        for value in values:
            if value.grad is None:
                value.grad = torch.zeros_like(value)
        return [value.grad for value in values if value.grad is not None]

    def _step(self, learns: bool) -> None:
        careful_step(self.model, self.optimizer)
        self.optimizer.zero_grad(set_to_none=True)
        if learns and self.learning is not None:
            self.learning.step()
        self.step += 1
        follow_weights(self.average, self.model, min(self.config.ema, (1 + self.step) / (10 + self.step)))

    @torch.no_grad()
    def validate(self, examples: list[Example]) -> tuple[float, float]:
        """Mean motion loss of the averaged model on fixed noise, with the right sentences and with those of other
        rows.
        """
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
        if self.learning is not None:
            self.learning.add_to(state)
        save_training_state(folder / "state.safetensors", state)
        notes = {
            "steps": self.step,
            "minutes": round(self.seconds / 60, 1),
            "batch": self.config.batch * self.processes.count,
        }
        known = max(
            0 if self.mesh_bank is None else len(self.mesh_bank),
            0 if self.learning is None else len(self.learning.bank),
        )
        save_denoiser(
            folder / "diffusion.safetensors",
            self.average,
            {**notes, "preset": self.config.preset, "characters": known, **self.notes},
        )

    def restore(self, path: Path, network: DenoiserConfig) -> None:
        """Go on from a saved state; one of before the discriminator gets a fresh one.

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
        if self.learning is not None:
            self.learning.restore(state)
        self.step, self.seconds = state.step, float(state.values["seconds"])
