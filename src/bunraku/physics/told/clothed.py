"""A character with physics in its file, as the apparel networks see it: what is apparel, and how stiff, heavy and
damped each part of it is, by the rigid bodies and joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.clothed import FREE, ClothedCharacter
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.parts import apparel_parts
from bunraku.apparel.stiffness import clothed_with_springs
from bunraku.apparel.unified import UnifiedBody
from bunraku.core.character import Character
from bunraku.errors import CharacterError
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.told.bending import NEWTON_METRE, bending_limits, body_springs
from bunraku.physics.told.swing import vertex_swing

__all__ = ["PartSprings", "clothed_from_file", "part_springs"]


@dataclass(frozen=True, eq=False)
class PartSprings:
    """Means over the bodies that hold the vertices of each of P parts.

    Args:
        spring: Stiffness of a joint against swinging [N m / rad], shape (P,), float32.
        mass: Of a body, as in the file, shape (P,).
        damping: Share of the velocity that a body loses in a second, shape (P,).
        limit: How far a joint may bend [rad], shape (P,).
    """

    spring: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    limit: np.ndarray


def part_springs(character: Character, rig: ApparelRig, parts: np.ndarray) -> PartSprings:
    """What the file says of each part; 0 where none of its bones has a body.

    Args:
        character: With a rig.
        rig: Its bodies and joints.
        parts: Number of the part of each vertex, -1 on the body, shape (V,).
    """
    own = character.rig
    assert own is not None
    count = int(parts.max(initial=-1)) + 1
    values = np.zeros((len(own.names), 5))
    for spring, limit, body in zip(
        body_springs(rig) * NEWTON_METRE, bending_limits(rig, own.parents), rig.bodies, strict=True
    ):
        if body.dynamic and body.bone >= 0:
            values[body.bone] += [spring, body.mass, body.linear_damping, limit, 1.0]
    sums = np.zeros((count, 5))
    cloth = parts >= 0
    for bone, share in zip(own.indices[cloth].T, own.weights[cloth].T, strict=True):
        known = values[bone, 4] > 0
        mean = values[bone] / np.maximum(values[bone, 4:], 1.0)
        np.add.at(sums, parts[cloth], mean * (share * known)[:, None])
    means = sums[:, :4] / np.maximum(sums[:, 4:], 1e-9)
    means[sums[:, 4] <= 0, 3] = FREE
    return PartSprings(*means.astype(np.float32).T)


def clothed_from_file(character: Character, body: UnifiedBody | None = None, dial: float = 1.0) -> ClothedCharacter:
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
    limp = np.zeros(len(springs.spring), np.float32)
    clothed = ClothedCharacter(
        character.vertices, character.faces, body.joints, body.weights, mask, part, limp, springs.damping
    )
    swing = vertex_swing(character, rig)
    return clothed_with_springs(clothed, springs.spring, springs.mass, springs.limit, dial, swing)
