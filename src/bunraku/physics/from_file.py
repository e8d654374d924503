"""What physics move of a character, from whatever its file says."""

from __future__ import annotations

from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.vrm_model import vrm_model
from bunraku.physics.apparel_rig import ApparelRig

__all__ = ["apparel_rig"]


def apparel_rig(character: Character) -> ApparelRig | None:
    """What physics move of a character; None where its file says nothing of physics, or nothing of it can be used.

    Args:
        character: An MMD model or a VRM avatar, with its rig.

    Raises:
        FormatError: The nodes of its file are broken.
    """
    if character.rig is None:
        return None
    model = mmd_model(character)
    if model is not None:
        found = ApparelRig(model.bodies, model.joints)
    else:
        avatar = vrm_model(character)
        if avatar is None:
            return None
        from bunraku.physics.vrm_chains import vrm_rig

        found = vrm_rig(character, avatar)
    return found if found.dynamic else None
