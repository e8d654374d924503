"""How far the legs of a body swing forward and back, left against right, and how far one is behind the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.retarget.stages.gaits.swings import pairs_of

__all__ = ["Pair", "gait_of"]

LOW, HIGH = 5, 95
"""Percentiles between which a leg swings."""
NEAR = 24
"""Vertices around a joint that tell where it is."""


@dataclass(frozen=True)
class Pair:
    """A left and a right leg.

    Args:
        left: Through which angle the left one swings [degrees].
        right: The same of the right one.
        phase: How far the right one is behind the left one, in cycles, 0 to 1.
    """

    left: float
    right: float
    phase: float

    @property
    def ratio(self) -> float:
        """The left one's swing over the right one's."""
        return self.left / max(self.right, 1e-9)


def gait_of(animation: Animation | RigAnimation, anatomy: Anatomy) -> list[Pair]:
    """The pairs of legs of a body, the foremost first.

    Args:
        animation: In which it goes straight.
        anatomy: Of its character, with the handles or bones that move it.
    """
    character = animation.character
    whole = Anatomy(character, anatomy.handles, character, anatomy.handles)
    vertices = animation.vertices().astype(np.float64)
    middle = vertices.mean(axis=1)
    way = (middle[-1] - middle[0]) * [1, 0, 1]
    ahead = way / max(float(np.linalg.norm(way)), 1e-9) if np.linalg.norm(way) > 0.1 * character.height else [0, 0, 1.0]
    pairs = []
    for pair in pairs_of(whole.legs):
        angles = []
        for leg in pair:
            near = np.argsort(np.linalg.norm(character.vertices - leg.joints[0], axis=1))[:NEAR]
            down = vertices[:, leg.sole].mean(axis=1) - vertices[:, near].mean(axis=1)
            angles.append(np.degrees(np.arctan2(down @ ahead, -down[:, 1])))
        swings = [float(np.ptp(np.percentile(angle, [LOW, HIGH]))) for angle in angles]
        pairs.append(Pair(swings[0], swings[1], _behind(*angles)))
    return pairs


def _behind(left: np.ndarray, right: np.ndarray) -> float:
    """How far one signal is behind another in cycles of the strongest frequency they share."""
    window = np.hanning(len(left))
    spectra = [np.fft.rfft((one - one.mean()) * window, 4 * len(one)) for one in (left, right)]
    shared = np.abs(spectra[0]) * np.abs(spectra[1])
    peak = int(shared[4:].argmax()) + 4
    return float((np.angle(spectra[0][peak]) - np.angle(spectra[1][peak])) / (2 * np.pi) % 1.0)
