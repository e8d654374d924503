"""Which way up a mesh belongs and which way it faces, and how to stand it up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.turning import turned
from bunraku.geometry.axes import AXES, ORIENTATIONS, axis_name, default_orientation, upright_rotation
from bunraku.geometry.surface_points import surface_points

if TYPE_CHECKING:
    from bunraku.handles.orientation_net import OrientationPredictor

__all__ = [
    "HABITS",
    "MAYBE",
    "SURE",
    "Orientation",
    "Settled",
    "guess_orientation",
    "settle",
    "settled_axes",
    "upright",
]

SURE = 0.9
"""A character is turned unasked from this confidence on; see the model card for how often that is wrong."""
MAYBE = 0.5
"""From this confidence on a guess is worth a word."""
_POINTS = 2048
_HABITS = {("+y", "+z"): 0.35, ("+z", "-y"): 0.2, ("+y", "-z"): 0.06, ("+y", "+x"): 0.04, ("+y", "-x"): 0.04,
           ("+z", "+y"): 0.04, ("+z", "+x"): 0.03, ("+z", "-x"): 0.03}  # fmt: skip
HABITS = np.array(
    [_HABITS.get(axes, (1 - sum(_HABITS.values())) / (len(ORIENTATIONS) - len(_HABITS))) for axes in ORIENTATIONS]
)
"""How common each of `ORIENTATIONS` is in files, roughly and by experience, shape (24,)."""


@dataclass(frozen=True, eq=False)
class Orientation:
    """What is up and what is the front of a character.

    Args:
        up: Its up axis, such as "+y".
        front: The axis that it faces, such as "+z".
        up_confidence: How likely the up axis is right, 0 to 1.
        front_confidence: How likely the front is right if the up axis is, 0 to 1.
        chances: How likely each of `geometry.axes.ORIENTATIONS` is, shape (24,).
    """

    up: str
    front: str
    up_confidence: float
    front_confidence: float
    chances: np.ndarray

    @staticmethod
    def of(chances: np.ndarray) -> Orientation:
        """The most likely up axis, and the most likely front with that axis up."""
        ups = np.array([up for up, _ in ORIENTATIONS])
        total = {up: float(chances[ups == up].sum()) for up in AXES}
        likely = max(total, key=lambda up: total[up])
        best = int(np.where(ups == likely, chances, -1).argmax())
        return Orientation(likely, ORIENTATIONS[best][1], total[likely], float(chances[best]) / total[likely], chances)

    @property
    def confidence(self) -> float:
        """How likely both axes are right, 0 to 1."""
        return self.up_confidence * self.front_confidence

    @property
    def rotation(self) -> np.ndarray:
        """What makes the character stand up along +Y and face +Z, shape (3, 3)."""
        return upright_rotation(self.up, self.front)


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> OrientationPredictor:
    from bunraku.handles.orientation_net import load_orientation_predictor

    return load_orientation_predictor(path)


def guess_orientation(
    character: Character,
    *,
    up: str | None = None,
    front: str | None = None,
    prior: np.ndarray = HABITS,
    checkpoint: str | Path | None = None,
) -> Orientation:
    """The most likely up axis of a character, and the most likely front with that axis up.

    Args:
        character: Any mesh; a rig that it may have is not looked at.
        up: Its up axis where that is known.
        front: The axis that it faces where that is known.
        prior: How likely each of `ORIENTATIONS` is before anyone looks at the shape; equal numbers let the shape speak
            alone.
        checkpoint: Weights of kind "orientation"; the shipped ones when not given.

    Raises:
        OptionError: What is known are no axes at a right angle.
        WeightsError: The checkpoint is missing or does not fit.
    """
    import torch

    from bunraku.handles.orientation_net import shape_tokens
    from bunraku.nn.checkpoints import shipped_checkpoint
    from bunraku.nn.threads import fitting_threads

    allowed = _allowed(up, front)
    path = Path(checkpoint) if checkpoint is not None else shipped_checkpoint("orientation")
    model = _model(path.resolve(), path.stat().st_mtime_ns if path.is_file() else 0)
    points, normals = surface_points(character.vertices, character.faces, _POINTS)
    tokens = torch.from_numpy(shape_tokens(points, normals, np.ones(len(points)), model.config.anchors))
    with torch.no_grad(), fitting_threads(model):
        chances = model.probabilities(tokens).double().numpy()
    chances = np.where(allowed, np.maximum(chances, 1e-12) * prior, 0)
    chances /= chances.sum()
    return Orientation.of(chances)


def _allowed(up: str | None, front: str | None) -> np.ndarray:
    """Which of `ORIENTATIONS` agree with what is known, shape (24,), bool."""
    up, front = (None if axis is None else axis_name(axis) for axis in (up, front))
    if up is not None and front is not None:
        upright_rotation(up, front)
    return np.array([(up is None or u == up) and (front is None or f == front) for u, f in ORIENTATIONS])


@dataclass(frozen=True, eq=False)
class Settled:
    """How a character is taken to stand.

    Args:
        up: Its up axis, such as "+z".
        front: The axis that it faces.
        guess: What was guessed, whether or not it was sure enough; None where both axes were said.
    """

    up: str
    front: str
    guess: Orientation | None = None


def settle(character: Character, up: str = "auto", front: str = "auto", *, sure: float = SURE) -> Settled:
    """How a character stands, from what is said about it and from its shape.

    Args:
        character: Any character.
        up: The axis that is up in it, such as "+z", or "auto" to guess.
        front: The axis that it faces, or "auto" to guess.
        sure: Least confidence to believe a guess; below, what is not said is taken as `default_orientation` says. A
            guess of the up axis may be believed alone.

    Raises:
        OptionError: An axis is none of the six, or the two are not at a right angle.
        WeightsError: The weights are missing or broken, and something is to be guessed.
    """
    said = [None if axis.strip().lower() == "auto" else axis_name(axis) for axis in (up, front)]
    if said[0] is not None and said[1] is not None:
        upright_rotation(said[0], said[1])
        return Settled(said[0], said[1])
    guess = guess_orientation(character, up=said[0], front=said[1])
    return Settled(*settled_axes(guess, sure, *said), guess)


def settled_axes(
    guess: Orientation, sure: float = SURE, up: str | None = None, front: str | None = None
) -> tuple[str, str]:
    """Up and front as a guess has them where it is sure, and as is usual where it is not; an axis that is known stays
    as it is.
    """
    if guess.up_confidence < sure:
        return default_orientation(up, front)
    return (guess.up, guess.front) if guess.confidence >= sure else default_orientation(guess.up, front)


def upright(character: Character, up: str = "auto", front: str = "auto") -> Character:
    """The character standing along +Y and facing +Z, as everything here wants it.

    Args:
        character: Any character.
        up: The axis that is up in it, such as "+z", or "auto" to guess.
        front: The axis that it faces, or "auto" to guess. It is turned by a guess only where that is nearly certain.

    Raises:
        OptionError: An axis is none of the six, or the two are not at a right angle.
        WeightsError: The weights are missing or broken, and something is to be guessed.
    """
    settled = settle(character, up, front)
    return turned(character, settled.up, settled.front)
