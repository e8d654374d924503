"""Clothed characters whose parts are as stiff as springs say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import FREE, NARROW, ClothedCharacter, part_stiffness
from bunraku.apparel.nodes import part_lengths

__all__ = ["clothed_with_springs"]


def clothed_with_springs(
    clothed: ClothedCharacter, spring: np.ndarray, mass: np.ndarray, limit: np.ndarray, dial: float = 1.0
) -> ClothedCharacter:
    """A clothed character whose parts are as stiff as a file says.

    Args:
        clothed: The character, of any stiffness.
        spring: Of a joint of each part [N m / rad], shape (P,).
        mass: Of a body of each [kg], shape (P,).
        limit: How far a joint of each may turn [rad], shape (P,).
        dial: Factor on the stiffness.
    """
    limit = np.clip(limit, NARROW, FREE).astype(np.float32)
    stiffness = part_stiffness(spring, mass, part_lengths(clothed), dial, limit)
    return replace(clothed, stiffness=stiffness, limit=limit)
