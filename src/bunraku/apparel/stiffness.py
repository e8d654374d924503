"""Wearers whose parts are as stiff as springs say."""

from __future__ import annotations

import numpy as np

from bunraku.apparel.nodes import part_lengths
from bunraku.apparel.wearer import Wearer, part_stiffness

__all__ = ["sprung_wearer"]


def sprung_wearer(
    rest: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray,
    part: np.ndarray, spring: np.ndarray, mass: np.ndarray, damping: np.ndarray, dial: float = 1.0,
) -> Wearer:  # fmt: skip
    """A wearer by what a file says of its parts.

    Args:
        rest, faces, joints, weights, apparel, part: As of `Wearer`.
        spring: Of a joint of each part [N m / rad], shape (P,).
        mass: Of a body of each [kg], shape (P,).
        damping: Share of the velocity that each loses in a second, shape (P,).
        dial: Factor on the springs.
    """
    blank = np.zeros(len(spring), np.float32)
    bare = Wearer(rest, faces, joints, weights, apparel, part, blank, damping)
    stiff = part_stiffness(spring, mass, part_lengths(bare), dial)
    return Wearer(rest, faces, joints, weights, apparel, part, stiff, damping)
