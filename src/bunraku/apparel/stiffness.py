"""Clothed characters whose parts are as stiff as springs say, and how their nodes swing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import FREE, NARROW, ClothedCharacter, part_stiffness
from bunraku.apparel.nodes import ApparelNodes, part_lengths
from bunraku.apparel.swing import Swing, guessed_swing

__all__ = ["clothed_with_springs", "node_swing"]


def clothed_with_springs(
    clothed: ClothedCharacter, spring: np.ndarray, mass: np.ndarray, limit: np.ndarray, dial: float = 1.0,
    swing: Swing | None = None,
) -> ClothedCharacter:  # fmt: skip
    """A clothed character whose parts are as stiff as a file says.

    Args:
        clothed: The character, of any stiffness.
        spring: Of a joint of each part [N m / rad], shape (P,).
        mass: Of a body of each [kg], shape (P,).
        limit: How far a joint of each may turn [rad], shape (P,).
        dial: Factor on the stiffness; limits are narrower by the root of it.
        swing: Of its vertices, where it is known.
    """
    limit = np.clip(limit, NARROW, FREE).astype(np.float32)
    stiffness = part_stiffness(spring, mass, part_lengths(clothed), dial, limit)
    rows = None if swing is None else swing.dialled(dial).rows()
    return replace(clothed, stiffness=stiffness, limit=limit, swing=rows)


def node_swing(clothed: ClothedCharacter, nodes: ApparelNodes) -> Swing:
    """How nodes swing: as the file says, or else as the stiffness of their parts would mean.

    Args:
        clothed: The character.
        nodes: Its nodes.
    """
    if clothed.swing is not None:
        return Swing.of_rows(clothed.swing[nodes.vertex])
    return guessed_swing(nodes.held, clothed.stiffness[nodes.part], clothed.damping[nodes.part])
