"""A character with physics in its file, as the apparel networks see it."""

from __future__ import annotations

from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.parts import apparel_parts
from bunraku.apparel.stiffness import sprung_wearer
from bunraku.apparel.unified import UnifiedBody
from bunraku.apparel.wearer import Wearer
from bunraku.core.character import Character
from bunraku.errors import CharacterError
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.part_springs import part_springs

__all__ = ["wearer_of_file"]


def wearer_of_file(character: Character, body: UnifiedBody | None = None, dial: float = 1.0) -> Wearer:
    """A character whose file says what its apparel is and how stiff.

    Args:
        character: With a rig of a person.
        body: Its joints, where they are known already.
        dial: Factor on the stiffness.

    Raises:
        CharacterError: The rig is not that of a person, or the file says nothing of physics.
    """
    body = body or UnifiedBody.of(character)
    rig, mask = apparel_rig(character), apparel_mask(character)
    if rig is None or mask is None or not mask.any():
        raise CharacterError(f"{character.name}: its file says nothing of apparel that physics move")
    part = apparel_parts(character.vertices, character.faces, mask)
    springs = part_springs(character, rig, part)
    return sprung_wearer(
        character.vertices, character.faces, body.joints, body.weights, mask, part, springs.spring, springs.mass,
        springs.damping, dial,
    )  # fmt: skip
