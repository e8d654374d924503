"""Training of the adaptation's last layer: mesh-specific learning and fine-tuning (Eq. 7 to 11 of TapMo)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from bunraku.core.files import remove_leftovers
from bunraku.errors import OptionError
from bunraku.generation.features import FeatureStatistics
from bunraku.language.encoders import TextEncoder, text_encoder
from bunraku_lab.datasets.characters.bank import CharacterBank, load_character_bank
from bunraku_lab.nn.checkpoints import TrainingState, load_training_state, save_training_state
from bunraku_lab.nn.denoiser import (
    Denoiser,
    capped_on_people,
    joint_offsets,
    load_denoiser,
    save_adapter,
    save_denoiser,
)
from bunraku_lab.training.adaptation.labels import (
    AdaptationHead,
    AdaptationPairs,
    EdgeSystem,
    MeshLosses,
    PairPlan,
    arap_labels,
    collect_pairs,
    edge_system,
    label_distance,
    whitening,
)
from bunraku_lab.training.losses.meshes import fit_locals, local_motion
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.clips import load_clips
from bunraku_lab.training.runs.run import (
    EventLog,
    Progress,
    Report,
    RunSettings,
    Stop,
    TrainingRun,
    learning_rate,
    plain_settings,
)

FRAMES = ("root", "joints")
"""What the layer may say."""


@dataclass(frozen=True, kw_only=True)
class AdaptationConfig(RunSettings):
    """Settings of the fine-tuning.

    Args:
        diffusion: The denoiser, as `bunraku train diffusion` wrote it.
        cache: The bank of characters that `bunraku data character-bank` wrote.
        data: Folder that `bunraku data motions` wrote.
        pairs: Motions on characters to learn from.
        frames: Frames of each.
        steps: Optimiser steps.
        edges: Edges of each character a step.
        strength: nu_v of Eq. 10, over a mean of the character's own ARAP-Loss and half the usual one [m^2].
        calm: Weight of delta's own squared length in Eq. 10, so that it stays short where edges do not ask for it.
        label_steps: Steps of Eq. 10, each held near the one before, for one label.
        label_weight: Weight of the distance to the labels (Eq. 11) [1 / cm^2]; 0 trains without labels.
        spring_weight: nu_h of Eq. 9.
        adversarial_weight: nu_a of Eq. 9.
        mesh_frames: Frames of each motion that those two look at.
        frame: What the layer says: "joints", how far joints should be moved, or "root", offsets as in the paper.
        mesh: Let the layer see the mesh token beside the hidden state.
        mesh_size: Main directions of the mesh token that are used.
        learning_rate: Peak.
        decay: Weight decay, in whitened coordinates.
        text_folder: Folder with CLIP, for a denoiser that was trained with it.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        save_every: Minutes between saved states.
    """

    diffusion: Path = Path("runs/diffusion/diffusion.safetensors")
    cache: Path = Path("runs/data/character_bank.npz")
    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/adaptation")
    pairs: int = 2000
    frames: int = 64
    steps: int = 2000
    batch: int = 12
    edges: int = 500
    strength: float = 0.02
    calm: float = 0.03
    label_steps: int = 1
    label_weight: float = 1.0
    spring_weight: float = 0.0
    adversarial_weight: float = 0.0
    mesh_frames: int = 32
    frame: str = "joints"
    mesh: bool = True
    mesh_size: int = 64
    learning_rate: float = 6e-4
    decay: float = 1e-3
    text_folder: Path | None = None
    device: str | None = None
    save_every: float = 5.0
    validate_every: int = 100
    seed: int = 0


WEIGHED = ("label_weight", "spring_weight", "adversarial_weight", "pairs", "batch")
"""Settings that the layer's own file tells."""


class _Run(TrainingRun):
    """Head, optimiser and data of one run."""

    stage = "adaptation"
    columns = ("loss",)

    def __init__(
        self, config: AdaptationConfig, model: Denoiser, bank: CharacterBank, pairs: AdaptationPairs,
        held: AdaptationPairs,
    ):  # fmt: skip
        self.config, self.model, self.pairs, self.held = config, model, pairs, held
        self.device = model.mean.device
        self.bank = bank.to(self.device)
        width, shift = model.config.width, model.get_parameter("adaptation_out.bias")
        weight = model.get_parameter("adaptation_out.weight").detach().float()
        inputs = width * (2 if config.mesh else 1)
        if weight.shape[1] < inputs:
            weight = torch.cat([weight, weight.new_zeros(len(weight), inputs - weight.shape[1])], 1)
        white, centre = whitening(pairs.seen.flatten(0, 1)[:, :inputs].float(), width, config.mesh_size)
        self.inputs = inputs
        self.head = AdaptationHead(weight, shift.detach().float(), white, centre, model.config.handles).to(self.device)
        self.optimizer = torch.optim.AdamW(self.head.parameters(), lr=config.learning_rate, weight_decay=config.decay)
        self.out, self.stop, self.held_out = config.out, Stop(), (pairs, held)
        self.step, self.seconds = 0, 0.0
        self.mesh_losses: MeshLosses | None = None
        if config.spring_weight > 0 or config.adversarial_weight > 0:
            self.mesh_losses = MeshLosses(
                self.bank, config.mesh_frames, config.spring_weight, config.adversarial_weight
            )
            self.armed = self.mesh_losses.able(pairs.row)
            if not len(self.armed):
                raise OptionError(f"{config.cache}: no character has arms, so spring and adversarial loss say nothing")
        self.usual = self._usual()
        self.last = time.monotonic()

    @torch.no_grad()
    def _usual(self) -> float:
        """Mean ARAP-Loss of some pairs without any adaptation."""
        random = np.random.default_rng(1)
        some = np.arange(0, len(self.pairs.row), max(1, len(self.pairs.row) // 64))
        return max(
            float(
                np.mean(
                    [self.systems(self.pairs, some[i : i + 8], random)[0].loss().mean() for i in range(0, len(some), 8)]
                )
            ),
            1e-6,
        )

    def systems(
        self, pairs: AdaptationPairs, which: np.ndarray, random: np.random.Generator
    ) -> tuple[EdgeSystem, Callable[[], Tensor]]:
        """Edges of some pairs in one frame of each token, and what gives the adaptation there, shape (B, T, K, 3)."""
        index = torch.from_numpy(which)
        seen, row = pairs.seen[index].to(self.device).float()[..., : self.inputs], pairs.row[index].to(self.device)
        features = pairs.motion[index].to(self.device).float() * self.model.std + self.model.mean
        patch, tokens = self.head.patch, seen.shape[1]
        phase = torch.from_numpy(random.integers(0, patch, (len(which), tokens))).to(self.device)
        each = torch.arange(len(which), device=self.device)[:, None]
        features = features[
            each, (torch.arange(tokens, device=self.device) * patch + phase).clamp(max=features.shape[1] - 1)
        ]
        picked = torch.from_numpy(random.choice(self.bank.edge_points.shape[1], self.config.edges, replace=False)).to(
            self.device
        )
        system = edge_system(fit_locals(*local_motion(features), self.bank, row), self.bank, picked)

        def adaptation() -> Tensor:
            said = self.head(seen)[each, torch.arange(tokens, device=self.device), phase]
            return self._moves(said, features)

        return system, adaptation

    def update(self) -> float:
        """One step of the weighted losses; their sum."""
        config = self.config
        random = np.random.default_rng([config.seed, self.step, 5])
        share = self.step / max(config.steps, 1)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(config.learning_rate, self.step, 20, share)
        losses = []
        if config.label_weight > 0:
            losses.append(config.label_weight * self._from_labels(random))
        if self.mesh_losses is not None:
            losses.append(self._from_meshes(self.mesh_losses, random))
        loss = torch.stack(losses).sum()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.head.parameters(), 100.0)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        return float(loss.detach())

    def _from_labels(self, random: np.random.Generator) -> Tensor:
        """Eq. 11 of some pairs [cm^2 a handle]."""
        config = self.config
        system, adaptation = self.systems(self.pairs, random.integers(0, len(self.pairs.row), config.batch), random)
        delta = adaptation()
        with torch.no_grad():  # a character that distorts a lot by nature does not outweigh all others
            own = system.loss().mean(1)
        strength = config.strength / (own + 0.5 * self.usual)
        return label_distance(
            delta, arap_labels(system, delta.detach(), strength, config.label_steps, calm=config.calm)
        )

    def _from_meshes(self, losses: MeshLosses, random: np.random.Generator) -> Tensor:
        """nu_h L_h + nu_a L_a of some pairs whose characters have arms."""
        index = torch.from_numpy(random.choice(self.armed, self.config.batch))
        seen, row = self.pairs.seen[index].to(self.device).float(), self.pairs.row[index].to(self.device)
        features = self.pairs.motion[index].to(self.device).float() * self.model.std + self.model.mean
        said = self.head(seen[..., : self.inputs]).flatten(1, 2)[:, : features.shape[1]]
        return losses(features, self._moves(said, features), row, random)

    def _moves(self, said: Tensor, features: Tensor) -> Tensor:
        """The adaptation [m] that the layer's words mean, shape (B, N, K, 3)."""
        return capped_on_people(joint_offsets(said, features) if self.config.frame == "joints" else said)

    @property
    def checkpoint(self) -> Path:
        """The denoiser with the new layer."""
        return self.out / "diffusion.safetensors"

    @property
    def save_every(self) -> float:
        return max(float(self.config.save_every), 1e-9)

    def progress(self) -> float:
        """Share of the steps done."""
        return self.step / self.config.steps

    def train_step(self) -> dict[str, float]:
        """One step, with the time since the one before."""
        loss = self.update()
        now = time.monotonic()
        self.seconds, self.last = self.seconds + now - self.last, now
        return {"loss": loss}

    def due(self) -> bool:
        """Whether it is time to validate; the last step is."""
        return super().due() or self.step == self.config.steps

    def begun(self) -> dict[str, float]:
        return {"step": self.step, "seconds": self.seconds}

    def event_log(self) -> EventLog:
        return EventLog(self.out / "events")

    def validate(self) -> dict[str, float]:
        """ARAP-Loss over that without adaptation on pairs that are learned from and on others, and delta's length."""
        seen, unseen = self.measure(self.pairs), self.measure(self.held)
        return {
            "seen": seen[0], "seen_each": seen[1], "unseen": unseen[0], "unseen_each": unseen[1], "delta": seen[2],
        }  # fmt: skip

    @torch.no_grad()
    def measure(self, pairs: AdaptationPairs, count: int = 96) -> tuple[float, float, float]:
        """ARAP-Loss with the adaptation over without, of the means and by pair; and delta's mean length [m]."""
        with_it, without, ratios, length = 0.0, 0.0, [], []
        random = np.random.default_rng(9)
        for start in range(0, min(count, len(pairs.row)), 8):
            system, adaptation = self.systems(pairs, np.arange(start, min(start + 8, len(pairs.row))), random)
            delta = adaptation()
            after, before = system.loss(delta).mean(1), system.loss().mean(1)
            with_it, without = with_it + float(after.sum()), without + float(before.sum())
            ratios += (after[before > 0] / before[before > 0]).tolist()
            length.append(float(delta[:, :, 1:].norm(dim=-1).mean()))
        return with_it / max(without, 1e-30), float(np.mean(ratios)), float(np.mean(length))

    def save(self, results: dict[str, float]) -> Path:
        """Write the state, then the checkpoint."""
        models, optimizers = {"head": self.head.state_dict()}, {"adamw": self.optimizer.state_dict()}
        settings = {"run": plain_settings(asdict(self.config))}
        state = TrainingState(self.step, models, optimizers, settings, {"seconds": self.seconds})
        if self.mesh_losses is not None:
            self.mesh_losses.learning.add_to(state)
        save_training_state(self.out / "state.safetensors", state)
        weight, bias = self.head.folded()
        tensors = {**self.model.state_dict(), "adaptation_out.weight": weight, "adaptation_out.bias": bias}
        built = Denoiser(
            replace(self.model.config, adaptation_mesh=self.config.mesh, adaptation_frame=self.config.frame)
        )
        built.load_state_dict(tensors)
        learned = {name: getattr(self.config, name) for name in WEIGHED} | {"steps": self.step}
        save_adapter(self.out / "adaptation.safetensors", built, learned)
        return save_denoiser(self.checkpoint, built, {**self.model.notes, "adaptation_steps": self.step})

    def restore(self, path: Path) -> None:
        """Go on from a saved state.

        Raises:
            OptionError: The state belongs to other data or another layer.
        """
        state = load_training_state(path)
        try:
            self.head.load_state_dict(state.models["head"])
            self.optimizer.load_state_dict(state.optimizers["adamw"])
        except Exception as error:
            problem = (
                "this run was started with another denoiser, bank or layer; give the same ones, or another run folder"
            )
            raise OptionError(f"{path}: {problem}") from error
        if self.mesh_losses is not None:
            self.mesh_losses.learning.restore(state)
        self.step, self.seconds = state.step, float(state.values["seconds"])


def train_adaptation(
    config: AdaptationConfig, report: Report | None = None, progress: Progress | None = None,
    encoder: TextEncoder | None = None,
) -> Path:  # fmt: skip
    """Fine-tune, or go on fine-tuning, and return the path of the denoiser with its new layer.

    Raises:
        OptionError: A setting is out of range, or the run folder belongs to another run.
        FormatError: The data or the bank are missing or damaged.
        WeightsError: The denoiser is missing or broken.
    """
    if config.frame not in FRAMES:
        raise OptionError(f"the frame '{config.frame}' is unknown; choose one of: {', '.join(FRAMES)}")
    if min(config.pairs, config.frames, config.steps, config.edges, config.label_steps) < 1:
        raise OptionError("pairs, frames, steps, edges and label steps must be positive")
    if max(config.label_weight, config.spring_weight, config.adversarial_weight) <= 0:
        raise OptionError("a label weight, a spring weight or an adversarial weight must be positive")
    config.prepare()
    device = torch.device(config.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    model = load_denoiser(config.diffusion, device)
    bank = load_character_bank(config.cache)
    if bank.features.shape[1] != model.config.mesh_features:
        raise OptionError(
            f"{config.cache}: its f_phi has {bank.features.shape[1]} numbers, but the denoiser takes "
            f"{model.config.mesh_features}"
        )
    if model.config.adaptation_frame != config.frame or (model.config.adaptation_mesh and not config.mesh):
        nn.init.zeros_(model.get_parameter("adaptation_out.weight"))  # what the layer said so far has another meaning
        nn.init.zeros_(model.get_parameter("adaptation_out.bias"))
    frames = min(config.frames, model.config.frames) // model.config.frames_per_token * model.config.frames_per_token
    remove_leftovers(config.out)
    if encoder is None:
        name = model.config.text_encoder
        encoder = text_encoder(name, config.text_folder if name.startswith("clip") else None)
    statistics = FeatureStatistics(model.mean.cpu().numpy(), model.std.cpu().numpy())
    clips = load_clips(config.data, (lambda done, total: progress("clips", done / total)) if progress else None)
    inputs = repr(
        (frames, config.seed, _stamp(config.diffusion), _stamp(config.cache), _stamp(config.data / "index.json"))
    )
    digest = hashlib.sha256(inputs.encode())
    pairs: list[AdaptationPairs] = []
    for split, count in (("train", config.pairs), ("test", max(config.pairs // 10, min(config.pairs, 96)))):
        rows, drawn = (
            bank.rows(split),
            ClipSet(clips, statistics, split, model.config.frames, Mixture(computed=0.0, borrowed=0.0)),
        )
        if not len(rows) or not drawn.clips:
            pairs.append(pairs[0]) if pairs else None
            continue
        pairs.append(collect_pairs(
            model, encoder, drawn, bank, rows, config.out / "pairs" / split,
            PairPlan(count, frames, digest.hexdigest(), config.seed),
            (lambda done, total: progress("motions on characters", done / total)) if progress else None,
        ))  # fmt: skip
    if not pairs:
        raise OptionError(f"{config.cache}: the bank or the clips have none of the split 'train' to learn from")
    run = _Run(config, model, bank, pairs[0], pairs[-1])
    state = config.out / "state.safetensors"
    if state.is_file():
        run.restore(state)
    return run.learn(report, progress)


def _stamp(path: Path) -> tuple[int, int]:
    return path.stat().st_size, path.stat().st_mtime_ns
