"""The rig of a character whose apparel is told apart: what carries a part holds it, whatever the skin said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import eased_border
from bunraku.apparel.parts import whole_pieces
from bunraku.body.layout import JOINT_COUNT
from bunraku.core.character import Character, Rig

__all__ = ["carried", "fitted_rig"]


def fitted_rig(character: Character, clothed: ClothedCharacter, bones: np.ndarray) -> Character:
    """The character with apparel on the bone of the joint that carries it: hair that lies on an arm goes with the head.
    Where apparel begins in the midst of a sheet, its skin passes over to that bone smoothly, so that nothing is torn.

    Args:
        character: With a rig.
        clothed: The same mesh, its parts whole on one joint each.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
    """
    rig = character.rig
    assert rig is not None
    share, joint = carried(clothed)
    carrier = np.asarray(bones)[joint][:, None].astype(np.int32)
    grown = Rig(
        rig.names, rig.parents, rig.transforms, np.concatenate([rig.indices, carrier], axis=1),
        np.concatenate([rig.weights * (1 - share[:, None]), share[:, None]], axis=1),
    )  # fmt: skip
    return replace(character, rig=grown)


def carried(clothed: ClothedCharacter) -> tuple[np.ndarray, np.ndarray]:
    """How much of each vertex goes with a joint whatever its skin said, shape (V,), and with which, shape (V,): apparel
    with what carries its part, and the rest of a loose piece that is mostly apparel with the same.
    """
    share, joint = eased_border(clothed), clothed.weights.argmax(axis=1)
    piece = whole_pieces(clothed.rest, clothed.faces, clothed.apparel)
    rows = np.flatnonzero(piece >= 0)
    if len(rows):
        votes = np.zeros((int(piece.max()) + 1, JOINT_COUNT))
        marked = rows[clothed.apparel[rows]]
        np.add.at(votes, (piece[marked], joint[marked]), 1)
        share, joint = np.array(share), np.array(joint)
        share[rows], joint[rows] = 1.0, votes.argmax(axis=1)[piece[rows]]
    return share, joint
