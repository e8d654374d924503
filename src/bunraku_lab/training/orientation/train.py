"""Training of the orientation network: resumable, with validation on characters that it never sees."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from bunraku.errors import OptionError
from bunraku.geometry.axes import ORIENTATIONS
from bunraku.handles.inference.orientation import OrientationConfig
from bunraku_lab.datasets.characters.training_character import AugmentConfig, TrainingCharacter
from bunraku_lab.nn.handles.orientation_net import (
    OrientationPredictor,
    load_orientation_predictor,
    save_orientation_predictor,
)
from bunraku_lab.training.orientation.measures import (
    FRONTS,
    OTHERS,
    UPRIGHT,
    fitted_temperature,
    orientation_results,
    validate_orientation,
    varied_tokens,
)
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings
from bunraku_lab.training.runs.training_run import Progress, Report

__all__ = ["OrientationTrainConfig", "OrientationTrainer", "train_orientation"]


@dataclass(frozen=True, kw_only=True)
class OrientationTrainConfig(StepSettings):
    """Settings of a training run.

    Args:
        cache: Folder of cached characters (`bunraku data characters`).
        device: Where to train.
        others: Rotations that are not upright, of the 20, that an example is compared with; each stands for its share.
        tilt: Largest tilt of an example [rad].
        reference_share: Share of the examples that are the reference body.
        start: A checkpoint whose weights the run begins with, of the same shape; random ones where not given.
    """

    cache: Path = Path("runs/data/characters")
    out: Path = Path("runs/orientation")
    minutes: float = 12.0
    device: str = "cpu"
    batch: int = 8
    others: int = 5
    rate: float = 1e-3
    warmup: int = 50
    weight_decay: float = 0.02
    tilt: float = 0.26
    reference_share: float = 0.05
    start: Path | None = None
    validate_every: int = 200
    predictor: OrientationConfig = field(default_factory=OrientationConfig)
    augment: AugmentConfig = field(default_factory=lambda: AugmentConfig(poses=0))


class OrientationTrainer(AveragedRun[OrientationPredictor]):
    """One training run in memory: the network, its optimiser, and the characters.

    Args:
        config: Settings.
        characters: To train on, all upright and facing +Z.
        held_out: To validate on.
        reference: The reference body's shapes, mixed in.
    """

    kind = "orientation"
    columns = ("loss", "won", "rate")

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
        self.temperature = 1.0
        self.set_up(lambda: OrientationPredictor(config.predictor).to(config.device), self._begin)
        self.chances = _chances([c.name for c in self.characters])

    def _begin(self, model: OrientationPredictor) -> None:
        if self.config.start is None:
            return
        given = load_orientation_predictor(self.config.start)
        if replace(given.config, temperature=1.0) != replace(self.config.predictor, temperature=1.0):
            raise OptionError(f"{self.config.start}: its network has another shape than this run; give its settings")
        model.load_state_dict(given.state_dict())

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

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The loss, and how often upright won among what it was compared with."""
        config = self.config
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
        won = float((scores.argmax(1) == FRONTS.index(UPRIGHT)).float().mean())
        return loss, {"won": won}

    def validate(self) -> dict[str, float]:
        """Figures of what was held out, as it is and varied, and the temperature that divides the scores."""
        logs = validate_orientation(self.average, self.held_out)
        every = logs.reshape(-1, len(ORIENTATIONS))
        plain, changed = (
            orientation_results(logs[:, 0]),
            orientation_results(logs[:, 1:].reshape(-1, len(ORIENTATIONS))),
        )
        results = {f"held_{name}": value for name, value in plain.items()}
        results |= {f"varied_{name}": value for name, value in changed.items()}
        self.temperature = fitted_temperature(every)
        return results | {"temperature": self.temperature}

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        shipped = OrientationPredictor(replace(self.average.config, temperature=self.temperature))
        shipped.load_state_dict(self.average.state_dict())
        return save_orientation_predictor(self.checkpoint, shipped, note, half=True)


def _chances(names: Sequence[str]) -> np.ndarray:
    """How often each example is drawn, so that large packs do not drown small ones, shape (C,)."""
    folders = [name.rpartition("/")[0] for name in names]
    counts = Counter(folders)
    share = np.array([counts[folder] ** -0.5 for folder in folders])
    return np.asarray(share / share.sum())


def train_orientation(
    config: OrientationTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the orientation network, or go on where the run in `config.out` stopped.

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).
        progress: Called with a stage's name and the share done.

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: No cache, or the folder cannot be written.
    """
    from bunraku_lab.datasets.characters.build import load_characters, reference_characters

    config.prepare()
    characters, held_out = load_characters(config.cache)
    reference = reference_characters() if config.reference_share > 0 else ()
    return OrientationTrainer(config, characters, held_out, reference).learn(report, progress)
