"""Training of the orientation network: resumable, with validation on characters that it never sees."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bunraku.errors import OptionError
from bunraku.geometry.axes import ORIENTATIONS
from bunraku.handles.orientation_net import OrientationConfig, OrientationPredictor, save_orientation_predictor
from bunraku_lab.datasets.characters.training_character import AugmentConfig, TrainingCharacter
from bunraku_lab.training.orientation.measures import (
    FRONTS,
    OTHERS,
    UPRIGHT,
    fitted_temperature,
    orientation_results,
    validate_orientation,
    varied_tokens,
)
from bunraku_lab.training.runs.drawn_run import DrawnRun
from bunraku_lab.training.runs.runs import append_row

__all__ = ["OrientationTrainConfig", "OrientationTrainer", "train_orientation"]


@dataclass(frozen=True)
class OrientationTrainConfig:
    """Settings of a training run.

    Args:
        cache: Folder of cached characters (`bunraku data characters`).
        out: Folder of the run: `state.safetensors` to go on from, `orientation.safetensors` the result, `log.csv`.
        minutes: Stop after this much training time on one core, over all sittings; the learning rate falls to nothing
            by then.
        steps: Stop after so many steps, where `minutes` is 0.
        threads: CPU threads; 0 leaves torch's choice.
        device: Where to train.
        batch: Meshes a step.
        others: Rotations that are not upright, of the 20, that an example is compared with; each stands for its share.
        rate: Peak learning rate of AdamW.
        warmup: Steps until the peak.
        decay: Decay of the running mean of the weights, which is what is validated and saved.
        weight_decay: Of AdamW.
        tilt: Largest tilt of an example [rad].
        reference_share: Share of the examples that are the reference body.
        validate_every: Steps between validations.
        seed: Of everything random.
    """

    cache: Path = Path("runs/data/characters")
    out: Path = Path("runs/orientation")
    minutes: float = 12.0
    steps: int = 2000
    threads: int = 1
    device: str = "cpu"
    batch: int = 8
    others: int = 5
    rate: float = 1e-3
    warmup: int = 50
    decay: float = 0.995
    weight_decay: float = 0.02
    tilt: float = 0.26
    reference_share: float = 0.05
    validate_every: int = 200
    seed: int = 1
    predictor: OrientationConfig = field(default_factory=OrientationConfig)
    augment: AugmentConfig = field(default_factory=lambda: AugmentConfig(poses=0))


class OrientationTrainer(DrawnRun[OrientationPredictor]):
    """One training run in memory: the network, its optimiser, and the characters.

    Args:
        config: Settings.
        characters: To train on, all upright and facing +Z.
        held_out: To validate on.
        reference: The reference body's shapes, mixed in.
    """

    kind = "orientation"

    def __init__(
        self,
        config: OrientationTrainConfig,
        characters: Sequence[TrainingCharacter],
        held_out: Sequence[TrainingCharacter] = (),
        reference: Sequence[TrainingCharacter] = (),
    ):
        if not characters:
            raise OptionError("there are no characters to train on; build the cache first")
        self.config = config
        self.characters, self.held_out, self.reference = list(characters), list(held_out), list(reference)
        torch.manual_seed(config.seed)
        model, average = (OrientationPredictor(config.predictor).to(config.device) for _ in range(2))
        adam = torch.optim.AdamW(model.parameters(), lr=config.rate, weight_decay=config.weight_decay)
        super().__init__(config.out, model, average, adam)
        self.rng = np.random.default_rng(config.seed)
        folders = [c.name.rpartition("/")[0] for c in self.characters]
        share = np.array([folders.count(f) ** -0.5 for f in folders])
        self.chances = share / share.sum()

    def loss(self, tokens: torch.Tensor, others: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Cross-entropy of the upright orientation against the three other fronts and a sample of the rest; and the
        scores.
        """
        chosen = [*FRONTS, *others]
        scores = self.model.scores(tokens, self.model.rotations[chosen])
        offset = torch.zeros(len(chosen), device=scores.device)
        offset[len(FRONTS) :] = math.log(len(OTHERS) / len(others))
        target = torch.full((len(scores),), chosen.index(UPRIGHT), device=scores.device)
        return torch.nn.functional.cross_entropy(scores + offset, target), scores

    def train_step(self) -> dict[str, float]:
        """One step; the loss, and how often upright won among what it was compared with."""
        config = self.config
        with self.timed():
            self.model.train()
            rate = self.set_rate(config.rate, config.warmup, self.progress())
            tokens = []
            for _ in range(config.batch):
                known = self.reference and self.rng.random() < config.reference_share
                character = (
                    self.reference[self.rng.integers(len(self.reference))]
                    if known
                    else self.characters[self.rng.choice(len(self.characters), p=self.chances)]
                )
                tokens.append(varied_tokens(character, self.rng, config.predictor.anchors, config.tilt, config.augment))
            others = self.rng.choice(OTHERS, size=min(config.others, len(OTHERS)), replace=False)
            loss, scores = self.loss(torch.from_numpy(np.stack(tokens)).to(config.device), others)
            loss.backward()  # type: ignore[no-untyped-call]
            self.update(config.decay)
        won = float((scores.argmax(1) == FRONTS.index(UPRIGHT)).float().mean())
        return {"loss": float(loss.detach()), "won": won, "rate": rate}

    def save(self, results: dict[str, float], temperature: float = 1.0) -> Path:
        """Write the training state and the checkpoint, whose scores a temperature divides; a kill leaves the last."""
        self.temperature = temperature
        return super().save(results)

    def write(self, note: dict[str, Any]) -> Path:
        """Write the checkpoint."""
        shipped = OrientationPredictor(replace(self.average.config, temperature=self.temperature))
        shipped.load_state_dict(self.average.state_dict())
        return save_orientation_predictor(self.checkpoint, shipped, note, half=True)


def train_orientation(config: OrientationTrainConfig, report: Callable[[dict[str, float]], None] | None = None) -> Path:
    """Train the orientation network, or go on where the run in `config.out` stopped.

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: No cache, or the folder cannot be written.
    """
    from bunraku_lab.datasets.characters.build import (
        load_characters,
        reference_characters,
    )  # the data is built on this package's types

    if config.threads > 0:
        torch.set_num_threads(config.threads)
    characters, held_out = load_characters(config.cache)
    trainer = OrientationTrainer(
        config, characters, held_out, reference_characters() if config.reference_share > 0 else ()
    )
    trainer.resume()
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    checkpoint, rows = out / "orientation.safetensors", []
    while trainer.progress() < 1:
        rows.append(trainer.train_step())
        if trainer.progress() < 1 and trainer.step % config.validate_every:
            continue
        row = {name: float(np.mean([r[name] for r in rows])) for name in rows[0]}
        results, temperature, rows = {}, 1.0, []
        if held_out:
            logs = validate_orientation(trainer.average, held_out)
            temperature = fitted_temperature(logs.reshape(-1, len(ORIENTATIONS)))
            results = {f"held_{name}": value for name, value in orientation_results(logs[:, 0]).items()}
            results |= {
                f"varied_{name}": value
                for name, value in orientation_results(logs[:, 1:].reshape(-1, len(ORIENTATIONS))).items()
            }
        checkpoint = trainer.save(results, temperature)
        row = {"step": trainer.step, "seconds": round(trainer.seconds, 1), **row, **results, "temperature": temperature}
        append_row(out / "log.csv", row)
        if report:
            report(row)
    return checkpoint
