"""A chain of links that swings: what bones that a body map leaves over become, and what is laid over bare apparel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.skeletons.apparel_names import APPAREL_KINDS

__all__ = ["KINDS", "Chain", "Manner", "laid_manner", "manner_of"]

KINDS = (*APPAREL_KINDS, "strand")
"""Kinds of chains; a strand is one of which nothing is known."""


@dataclass(frozen=True)
class Manner:
    """How a chain swings.

    Args:
        limit: How far a link turns against the one above it [rad].
        inward: How far of that it turns towards the body, as a share.
        stiffness: Spring of a link, over the moment of the weight that hangs on it; 0 for none.
        damping: Share of the velocity that is lost in a second.
        mass: Of the first link [kg]; those below are lighter, the last has half.
        gravity: Factor on gravity.
        root: Of its limits, what the first link has; those below have more, the last all of them.
    """

    limit: float
    inward: float
    stiffness: float
    damping: float
    mass: float = 0.5
    gravity: float = 1.0
    root: float = 1.0

    def turned(self, stiffness: float = 1.0, gravity: float = 1.0) -> Manner:
        """As a user's dials ask: springs so many times as stiff and limits narrower by the root of that, gravity so
        many times as strong.
        """
        narrow = float(np.clip(stiffness, 0.01, 100.0) ** -0.5)
        return replace(
            self, stiffness=self.stiffness * stiffness, limit=min(self.limit * narrow, 1.4),
            gravity=self.gravity * gravity,
        )  # fmt: skip


# Limits and damping are medians of twelve MMD and VRM files and of the wardrobe: hair and tails turn 10 to 35 degrees,
# cloth 15 to 50, little hard pieces 5 to 15, and 0.8 to 0.99 of the velocity is lost in a second.
_DEGREE = np.pi / 180
_MANNERS = {
    "hair": Manner(22 * _DEGREE, 0.6, 0.6, 0.93),
    "skirt": Manner(32 * _DEGREE, 0.25, 0.35, 0.93),
    "cape": Manner(32 * _DEGREE, 0.35, 0.2, 0.93),
    "sleeve": Manner(25 * _DEGREE, 1.0, 0.5, 0.93),
    "tail": Manner(22 * _DEGREE, 1.0, 1.0, 0.93),
    "ear": Manner(12 * _DEGREE, 1.0, 3.0, 0.95),
    "ribbon": Manner(30 * _DEGREE, 0.5, 0.4, 0.93, mass=0.25),
    "strand": Manner(18 * _DEGREE, 0.8, 0.8, 0.93),
}


# Of chains that are laid over a shape: what came nearest to the simulated wardrobe, kind by kind, on 18 characters for
# training. There shape says nothing of limits and springs beyond the kind (a regression on length, width, place, number
# and direction explains 1 % of the limits' variance on held-out characters), so they are guessed on the narrow side.
_LAID = {
    "hair": Manner(12 * _DEGREE, 1.0, 0.3, 0.93),
    "skirt": Manner(13 * _DEGREE, 1.0, 0.3, 0.88),
    "cape": Manner(15 * _DEGREE, 1.0, 0.3, 0.9),
    "sleeve": Manner(8 * _DEGREE, 1.0, 0.3, 0.95),
    "tail": Manner(9 * _DEGREE, 1.0, 0.3, 0.9),
    "ear": Manner(5 * _DEGREE, 1.0, 1.0, 0.95),
    "ribbon": Manner(10 * _DEGREE, 1.0, 0.4, 0.93, mass=0.25),
    "strand": Manner(10 * _DEGREE, 1.0, 0.4, 0.93),
}
LONG = 0.15
"""Of the size [m]: shorter chains hold their shape more."""
SHORT_SHARE = 0.4  # of its limits, that the shortest chain has at least
ROOT = 0.5  # of its limits, that the first link of a chain has


def laid_manner(kind: str, length: float) -> Manner:
    """How a chain swings that is laid over a shape.

    Args:
        kind: One of `KINDS`.
        length: Over the size of the character.
    """
    manner = _LAID[kind]
    return replace(manner, limit=manner.limit * float(np.clip(length / LONG, SHORT_SHARE, 1.0)), root=ROOT)


def manner_of(kind: str) -> Manner:
    """How apparel of a kind swings where nothing more is known of it."""
    return _MANNERS[kind]


@dataclass(frozen=True, eq=False)
class Chain:
    """R links in a row.

    Args:
        name: Of its first bone.
        kind: One of `KINDS`.
        bones: Bone of the rig that each link is, shape (R,).
        points: Where the links begin, and where the last one ends [m], shape (R + 1, 3).
        holder: The bone that it hangs on; a link of another chain where it branches off.
        width: Half the width of what each link holds [m], shape (R,).
        thick: Half its thickness [m].
        manner: How it swings.
    """

    name: str
    kind: str
    bones: np.ndarray
    points: np.ndarray
    holder: int
    width: np.ndarray
    thick: float
    manner: Manner

    @property
    def length(self) -> float:
        """From its first point along its links to the last [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def __len__(self) -> int:
        return len(self.bones)
