"""A character as the apparel networks see it: mesh, joints, what these hold, what is apparel, how stiff it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.errors import CharacterError

__all__ = [
    "FREE",
    "GRAVITY",
    "LEGS",
    "LOADS",
    "NARROW",
    "NORMAL_STIFFNESS",
    "SIZE",
    "SOFTEST",
    "STIFFEST",
    "ClothedCharacter",
    "part_stiffness",
]

LEGS = tuple(
    JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle", "foot") for side in ("left", "right")
)
"""Their joints."""
SIZE = 1.6
"""Height that the networks know characters at [m]; others are measured in units of theirs over this."""
GRAVITY = 7.84
"""Of MMD files, 98 of their units [m/s^2]."""
NORMAL_STIFFNESS = -0.4
"""Of cloth that hangs, the median of the wardrobe: what a part counts for that neither springs nor limits hold."""
SOFTEST, STIFFEST = -2.2, 2.0
"""What the networks have seen."""
FREE = np.pi
"""Limit of a joint that may turn as it likes [rad]."""
NARROW = 0.01
"""The narrowest limit that is told from a locked joint [rad]."""
LOADS = 0.3
"""log10 of how many times its weight pulls at a part that moves: springs that so much turns as far as the limits let it
hold as the limits do.
"""


def part_stiffness(
    spring: np.ndarray, mass: np.ndarray, length: np.ndarray, dial: float = 1.0, limit: np.ndarray | None = None
) -> np.ndarray:
    """Stiffness of parts as the networks take it: log10 of a joint's spring over the moment of a body at the part's
    end, from -2.2, where it hangs freely, to 2, where it stands; shape (P,), float32. A part that limits hold in its
    shape is as stiff as one whose springs let it turn no farther.

    Args:
        spring: Of a joint [N m / rad], shape (P,).
        mass: Of a body [kg], shape (P,).
        length: Of the part [m], shape (P,).
        dial: Factor that the user requests.
        limit: How far a joint may turn [rad], shape (P,); None for as far as it likes.
    """
    moment = np.maximum(np.asarray(mass, np.float64), 1e-4) * GRAVITY * np.maximum(length, 1e-3)
    spring = np.asarray(spring, np.float64)
    ratio = np.where(spring > 0, np.log10(np.maximum(spring, 1e-8) / moment), NORMAL_STIFFNESS)
    if limit is not None:
        turn = np.clip(np.asarray(limit, np.float64), NARROW, FREE)
        ratio = np.where(turn < FREE, np.maximum(ratio, LOADS - np.log10(turn)), ratio)
    return np.asarray(np.clip(ratio + np.log10(dial), SOFTEST, STIFFEST), np.float32)


@dataclass(frozen=True, eq=False)
class ClothedCharacter:
    """A character with apparel.

    Args:
        rest: Rest mesh V [m], shape (V, 3), float32.
        faces: Shape (F, 3).
        joints: J, SMPL's 22 joints in the rest pose [m], shape (22, 3).
        weights: Skinning weights W for the joints, shape (V, 22); an apparel vertex has those of what carries it.
        apparel: The mask, shape (V,), bool.
        part: Number of the apparel part of each vertex, -1 on the body, shape (V,).
        stiffness: Of each part (`part_stiffness`), shape (P,).
        damping: Of each part: share of the velocity that it loses in a second, shape (P,).
        limit: Of each part: how far a joint of it may turn [rad], shape (P,); as far as it likes when None.
        swing: How each vertex swings by the joints above it, rows of `Swing`, shape (V, SWING_NUMBERS); None where only
            the parts' stiffness is known.

    Raises:
        CharacterError: The shapes do not fit.
    """

    rest: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    apparel: np.ndarray
    part: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    limit: np.ndarray = None  # type: ignore[assignment]
    swing: np.ndarray | None = None

    def __post_init__(self) -> None:
        count, parts = len(self.rest), int(self.part.max(initial=-1)) + 1
        if self.limit is None:
            object.__setattr__(self, "limit", np.full(parts, FREE, np.float32))
        good = self.weights.shape == (count, JOINT_COUNT) and self.joints.shape == (JOINT_COUNT, 3)
        good &= self.apparel.shape == self.part.shape == (count,)
        good &= self.swing is None or len(self.swing) == count
        if not good or len(self.stiffness) != parts or len(self.damping) != parts or len(self.limit) != parts:
            raise CharacterError("the mesh, its weights and its apparel are not of one character")

    @property
    def scale(self) -> float:
        """Its size over the one that the networks know."""
        return max(float(np.ptp(self.rest[:, 1])), 1e-6) / SIZE
