"""How well the orientation network knows how characters stand, and the variants that it is trained and tested with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from bunraku.geometry.axes import ORIENTATIONS
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.handles.inference.orientation import shape_tokens
from bunraku_lab.datasets.characters.training_character import AugmentConfig, TrainingCharacter, augment
from bunraku_lab.nn.handles.orientation_net import OrientationPredictor

__all__ = [
    "FRONTS",
    "OTHERS",
    "UPRIGHT",
    "fitted_temperature",
    "orientation_results",
    "validate_orientation",
    "varied_tokens",
]

UPRIGHT = ORIENTATIONS.index(("+y", "+z"))
"""The orientation of all training characters."""
FRONTS = [n for n, (up, _) in enumerate(ORIENTATIONS) if up == "+y"]
"""Those that stand upright, whatever they face."""
OTHERS = [n for n, (up, _) in enumerate(ORIENTATIONS) if up != "+y"]
"""Those that do not."""


def varied_tokens(
    character: TrainingCharacter,
    rng: np.random.Generator,
    anchors: int = 128,
    tilt: float = 0.26,
    config: AugmentConfig | None = None,
) -> np.ndarray:
    """Tokens of a random variant of an upright character that is still nearly upright, shape (M, 10).

    Args:
        character: The character.
        rng: Source of randomness.
        anchors: Tokens, M.
        tilt: Largest tilt [rad].
        config: How its rest pose and proportions vary.
    """
    mesh = augment(character, rng, config or AugmentConfig(poses=0))
    axis = rng.normal(size=3)
    turn = np.asarray(matrix_from_axis_angle(axis / np.linalg.norm(axis) * rng.uniform(0, tilt)))
    return _spoilt(mesh.vertices, mesh.normals, mesh.areas, rng, anchors, turn)


def _spoilt(
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
    model: OrientationPredictor,
    characters: Sequence[TrainingCharacter],
    variants: int = 2,
    seed: int = 0,
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
    model.eval()
    rows = []
    for number, c in enumerate(characters):
        rng = np.random.default_rng([seed, number])
        tokens = [shape_tokens(c.vertices, c.normals, c.areas, model.config.anchors)] + [
            varied_tokens(c, rng, model.config.anchors) for _ in range(variants)
        ]
        rows.append(
            np.stack(
                [
                    model.probabilities(torch.from_numpy(some).to(model.rotations.device)).log().cpu().numpy()
                    for some in tokens
                ]
            )
        )
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
        "up": float((by_up.argmax(1) == own).mean()),
        "front": float(front.mean()),
        "both": float((logs.argmax(1) == UPRIGHT).mean()),
        "loss": float(-logs[:, UPRIGHT].mean()),
    }


def fitted_temperature(logs: np.ndarray) -> float:
    """The temperature, 0.5 to 5, at which log-probabilities (N, 24) of upright characters have the least
    cross-entropy.
    """
    choices = np.exp(np.linspace(np.log(0.5), np.log(5), 60))

    def loss(temperature: float) -> float:
        scaled = logs / temperature
        return float(
            np.mean(np.log(np.exp(scaled - scaled.max(1, keepdims=True)).sum(1)) + scaled.max(1) - scaled[:, UPRIGHT])
        )

    return float(min(choices, key=loss))
