"""Training of the orientation network, and the weights of the simple evidence beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from bunraku.anatomy.handles.networks import OrientationConfig, shape_tokens
from bunraku.core.geometry.axes import ORIENTATIONS
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import OptionError
from bunraku_lab.datasets.characters.training_character import (
    AugmentConfig,
    TrainingCharacter,
    augment,
    folder_chances,
)
from bunraku_lab.nn.handles import OrientationPredictor
from bunraku_lab.training.handles import on_base, with_prop
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings, TrainingNote

UPRIGHT = ORIENTATIONS.index(("+y", "+z"))
"""The orientation of all training characters."""
FRONTS = [n for n, (up, _) in enumerate(ORIENTATIONS) if up == "+y"]
"""Those that stand upright, whatever they face."""
OTHERS = [n for n, (up, _) in enumerate(ORIENTATIONS) if up != "+y"]
"""Those that do not."""


BESIDE_RATE = 0.1  # share of the examples with a base, and with a prop; chosen, not measured


def varied_tokens(
    character: TrainingCharacter, rng: np.random.Generator, anchors: int = 128, tilt: float = 0.26,
    config: AugmentConfig | None = None,
) -> np.ndarray:  # fmt: skip
    """Tokens of a random variant of an upright character that is still nearly upright, shape (M, 10).

    Args:
        character: The character.
        rng: Source of randomness.
        anchors: Tokens, M.
        tilt: Largest tilt [rad].
        config: How its rest pose and proportions vary.
    """
    mesh = augment(character, rng, config or AugmentConfig(poses=0))
    for change in (on_base, with_prop):
        mesh = change(mesh, rng) if rng.random() < BESIDE_RATE else mesh
    axis = rng.normal(size=3)
    turn = np.asarray(matrix_from_axis_angle(axis / np.linalg.norm(axis) * rng.uniform(0, tilt)))
    return _corrupted(mesh.vertices, mesh.normals, mesh.areas, rng, anchors, turn)


def _corrupted(
    points: np.ndarray, normals: np.ndarray, areas: np.ndarray, rng: np.random.Generator, anchors: int, turn: np.ndarray
) -> np.ndarray:
    """Tokens of another sampling of a surface, with noise, turned; now and then with its normals inside out."""
    kept = rng.random(len(points)) < rng.uniform(0.5, 1)
    kept = kept if kept.sum() >= anchors else np.ones(len(kept), bool)
    points = points[kept] + rng.normal(0, 0.004, (int(kept.sum()), 3))
    areas = areas[kept] * np.exp(rng.normal(0, 0.2, len(points)))
    inside_out = -1 if rng.random() < 0.03 else 1
    return shape_tokens(points @ turn.T, inside_out * normals[kept] @ turn.T, areas, anchors)


@torch.no_grad()
def validate_orientation(
    model: OrientationPredictor, characters: Sequence[TrainingCharacter], variants: int = 2, seed: int = 0
) -> np.ndarray:
    """Log-probabilities of all orientations for characters that are upright, as they are and varied.

    Args:
        model: The network.
        characters: With labels.
        variants: Varied forms of each (rest pose, proportions, tilt) beside its own.
        seed: Of the variants.

    Returns:
        Shape (C, 1 + variants, 24).
    """
    network = model.running()
    rows = []
    for number, c in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        tokens = [shape_tokens(c.vertices, c.normals, c.areas, model.config.anchors)] + [
            varied_tokens(c, rng, model.config.anchors) for _ in range(variants)
        ]
        rows.append(np.log([network.probabilities(some) for some in tokens]))
    return np.stack(rows)


def orientation_results(logs: np.ndarray) -> dict[str, float]:
    """Accuracy of log-probabilities of shape (N, 24), all of characters that are upright.

    Returns:
        up: Share whose up axis is right (6 ways). front: share whose front is right given the right up (4 ways). both:
        share whose orientation is right (24 ways). loss: mean cross-entropy.
    """
    ups = np.array([up for up, _ in ORIENTATIONS])
    chances = np.exp(logs)
    by_up = np.stack([chances[:, ups == up].sum(1) for up in dict.fromkeys(ups)], axis=1)
    own = list(dict.fromkeys(ups)).index("+y")
    front = logs[:, FRONTS].argmax(1) == FRONTS.index(UPRIGHT)
    return {
        "up": float((by_up.argmax(1) == own).mean()), "front": float(front.mean()),
        "both": float((logs.argmax(1) == UPRIGHT).mean()), "loss": float(-logs[:, UPRIGHT].mean()),
    }  # fmt: skip


def fitted_temperature(logs: np.ndarray) -> float:
    """The temperature, 0.5 to 5, with the least cross-entropy of log-probabilities (N, 24)."""
    choices = np.exp(np.linspace(np.log(0.5), np.log(5), 60))

    def loss(temperature: float) -> float:
        scaled = logs / temperature
        return float(
            np.mean(np.log(np.exp(scaled - scaled.max(1, keepdims=True)).sum(1)) + scaled.max(1) - scaled[:, UPRIGHT])
        )

    return float(min(choices, key=loss))


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
    """One training run in memory: the network, its optimiser, and the characters."""

    kind = "orientation"
    columns = ("loss", "won", "rate")

    def __init__(
        self, config: OrientationTrainConfig, characters: Sequence[TrainingCharacter],
        held_out: Sequence[TrainingCharacter] = (), reference: Sequence[TrainingCharacter] = (),
    ):  # fmt: skip
        if not characters:
            raise OptionError("there are no characters to train on; build the cache first")
        self.config = config
        self.characters, self.held_out, self.reference = list(characters), list(held_out), list(reference)
        self.temperature = 1.0
        self.set_up(lambda: OrientationPredictor(config.predictor).to(config.device), self._begin)
        self.chances = folder_chances([c.name for c in self.characters])

    def _begin(self, model: OrientationPredictor) -> None:
        if self.config.start is None:
            return
        given = OrientationPredictor.load(self.config.start)
        if replace(given.config, temperature=1.0) != replace(self.config.predictor, temperature=1.0):
            raise OptionError(f"{self.config.start}: its network has another shape than this run; give its settings")
        model.load_state_dict(given.state_dict())

    def loss(self, tokens: np.ndarray, others: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Cross-entropy of the upright orientation against three other fronts and a sample; and the scores."""
        chosen = [*FRONTS, *others]
        scores = self.model.scores(tokens, chosen)
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
        loss, scores = self.loss(np.stack(tokens), others)
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
        shipped = OrientationPredictor(replace(self.average.config, temperature=self.temperature))
        shipped.load_state_dict(self.average.state_dict())
        return shipped.save(self.checkpoint, note, half=True)


def train_orientation(
    config: OrientationTrainConfig, report: Report | None = None, progress: Progress | None = None
) -> Path:
    """Train the orientation network, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: No cache, or the folder cannot be written.
    """
    from bunraku_lab.datasets.characters.build import load_characters, reference_characters

    config.prepare()
    characters, held_out = load_characters(config.cache)
    reference = reference_characters() if config.reference_share > 0 else ()
    return OrientationTrainer(config, characters, held_out, reference).learn(report, progress)
