"""What `bunraku inspect` tells of hair and clothes whose file says nothing of physics: the chains that their bones
become, or that are laid over their shape, the parts of it that the networks find, and what is guessed of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bunraku.core.character import Character
from bunraku.errors import CharacterError

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.physics.chains.chain import Chain

__all__ = ["apparel_facts", "say_chain", "say_part", "shape_facts"]


def apparel_facts(character: Character) -> dict[str, Any]:
    """The chains of a character's bones; nothing where its file says how apparel moves, or there are none."""
    from bunraku.physics.chains.from_bones import bone_chains
    from bunraku.physics.from_file import apparel_rig

    if character.rig is None or apparel_rig(character) is not None:
        return {}
    chains = bone_chains(character)
    if not chains:
        return {}
    return _chain_facts(chains, character.rig.names)


def shape_facts(anatomy: Anatomy) -> dict[str, Any]:
    """What the networks find on a person's mesh: the parts of its apparel, and the chains that are laid over them, as
    `apparel_facts` tells those of bones; nothing where none is found.
    """
    from bunraku.pipelines.clothes import clothed_of, rig_with_chains

    try:
        clothed = clothed_of(anatomy)
        if not clothed.apparel.any():
            return {}
        parts = _part_facts(anatomy.character, clothed)
        made = rig_with_chains(anatomy, clothed=clothed)
    except CharacterError:  # nothing was found, or not on such a body
        return {}
    assert made.character.rig is not None
    return {"apparel": parts} | _chain_facts(made.chains, made.character.rig.names)


def _part_facts(character: Character, clothed: Any) -> list[dict[str, Any]]:
    """Each part of the mask, and how the network takes it to swing."""
    import numpy as np

    from bunraku.apparel.clothed import FREE, LOADS, NARROW
    from bunraku.body.layout import JOINT_NAMES
    from bunraku.physics.chains.from_shape import shape_chains
    from bunraku.physics.chains.manners_file import manners_beside
    from bunraku.physics.chains.told_parts import part_kinds, with_told_parts

    kinds = part_kinds(clothed, shape_chains(clothed))
    clothed = with_told_parts(clothed, manners_beside(character))
    whole = max(float(character.areas.sum()), 1e-30)
    out = []
    for number, kind in enumerate(kinds):
        rows = np.flatnonzero(clothed.part == number)
        joint = int(clothed.weights[rows].mean(axis=0).argmax())
        ratio = float(clothed.stiffness[number])
        turn = min(float(clothed.limit[number]), float(np.clip(10.0 ** (LOADS - ratio), NARROW, FREE)))
        out.append(
            {
                "part": number, "kind": kind or "unknown", "vertices": len(rows),
                "area": round(float(character.areas[rows].sum()) / whole, 4), "hangs_on": JOINT_NAMES[joint],
                "stiffness": float(f"{10.0**ratio:.3g}"), "limit": round(float(np.degrees(turn)), 1),
                "damping": round(float(clothed.damping[number]), 3),
            }
        )  # fmt: skip
    return out


def _chain_facts(chains: Sequence[Chain], names: Sequence[str]) -> dict[str, Any]:
    import numpy as np

    return {
        "chains": [
            {
                "name": chain.name, "kind": chain.kind, "links": len(chain), "length": round(chain.length, 4),
                "hangs_on": names[chain.holder],
                "limit": round(float(np.degrees(chain.manner.limit)), 1), "stiffness": chain.manner.stiffness,
                "damping": chain.manner.damping, "gravity": chain.manner.gravity, "mass": chain.manner.mass,
            }
            for chain in chains
        ]
    }  # fmt: skip


def say_chain(chain: dict[str, Any]) -> str:
    """A chain in words: what it was taken for."""
    return f"{chain['name']} ({chain['kind']}, {chain['links']} links on {chain['hangs_on']}, {_manner(chain)})"


def say_part(part: dict[str, Any]) -> str:
    """A part in words."""
    return f"{part['kind']} on {part['hangs_on']} ({part['vertices']:,} vertices, {_manner(part)})"


def _manner(one: dict[str, Any]) -> str:
    return f"turns {one['limit']:g} degrees, stiffness {one['stiffness']:g}, damping {one['damping']:g}"
