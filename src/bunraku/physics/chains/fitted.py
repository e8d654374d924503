"""The rig of a character whose apparel is told apart: what carries a part holds it, whatever the skin said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import eased_border
from bunraku.core.character import Character, Rig

__all__ = ["fitted_rig"]


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
    share = eased_border(clothed)[:, None]
    carrier = np.asarray(bones)[clothed.weights.argmax(axis=1)][:, None].astype(np.int32)
    grown = Rig(
        rig.names, rig.parents, rig.transforms, np.concatenate([rig.indices, carrier], axis=1),
        np.concatenate([rig.weights * (1 - share), share], axis=1),
    )  # fmt: skip
    return replace(character, rig=grown)
