"""Which vertices of a character are apparel: those that an artist says, or else those that the physics of an MMD or VRM
file move.
"""

from __future__ import annotations

import numpy as np

from bunraku.apparel.artist_mask import artist_mask
from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdModel, mmd_model
from bunraku.core.vrm_model import VrmModel, vrm_model

__all__ = ["APPAREL_SHARE", "apparel_mask", "moved_joints"]

APPAREL_SHARE = 0.5


def apparel_mask(character: Character, model: MmdModel | VrmModel | None = None) -> np.ndarray | None:
    """Vertices whose weight on joints that physics move exceeds a half, shape (V,), bool; None where the file says
    nothing of physics.

    A mask beside the file (`artist_mask`) replaces that.

    Args:
        character: With a rig.
        model: What its file says, where that is known already.

    Raises:
        FormatError: The nodes of its file, or the mask beside it, are broken.
    """
    drawn = artist_mask(character)
    if drawn is not None:
        return drawn
    moved = moved_joints(character, model)
    if moved is None or character.rig is None:
        return None
    return np.asarray((character.rig.weights * moved[character.rig.indices]).sum(axis=1) > APPAREL_SHARE)


def moved_joints(character: Character, model: MmdModel | VrmModel | None = None) -> np.ndarray | None:
    """Joints of the rig with dynamic rigid bodies or on springs, and all joints below them, shape (J,), bool; None as
    above.
    """
    rig = character.rig
    model = model or mmd_model(character) or vrm_model(character)
    if model is None or rig is None:
        return None
    out = np.zeros(len(rig.names), bool)
    if isinstance(model, MmdModel):
        out[[body.bone for body in model.bodies if body.dynamic and body.bone >= 0]] = True
    else:
        index = {node: joint for joint, node in enumerate(character.source.skins.nodes)}
        out[[index[joint.node] for spring in model.springs for joint in spring.joints if joint.node in index]] = True
    while True:  # once for each level of the tree at the most
        grown = out | np.where(rig.parents >= 0, out[rig.parents], False)
        if (grown == out).all():
            return out
        out = grown
