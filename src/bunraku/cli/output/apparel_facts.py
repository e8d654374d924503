"""What `bunraku inspect` tells of hair and clothes whose file says nothing of physics: the chains that their bones
become, or that are laid over their shape, and what is guessed of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bunraku.core.character import Character
from bunraku.errors import CharacterError

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.physics.chains.chain import Chain

__all__ = ["apparel_facts", "say_chain", "shape_facts"]


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
    """The chains that are laid over the apparel of a person's mesh, as `apparel_facts` tells those of bones; nothing
    where none is found.
    """
    from bunraku.pipelines.clothes import rig_with_chains

    try:
        made = rig_with_chains(anatomy)
    except CharacterError:  # nothing was found, or not on such a body
        return {}
    assert made.character.rig is not None
    return _chain_facts(made.chains, made.character.rig.names)


def _chain_facts(chains: Sequence[Chain], names: Sequence[str]) -> dict[str, Any]:
    import numpy as np

    return {
        "chains": [
            {
                "name": chain.name, "kind": chain.kind, "links": len(chain), "length": round(chain.length, 4),
                "hangs_on": names[chain.holder],
                "limit": round(float(np.degrees(chain.manner.limit)), 1), "stiffness": chain.manner.stiffness,
                "damping": chain.manner.damping,
            }
            for chain in chains
        ]
    }  # fmt: skip


def say_chain(chain: dict[str, Any]) -> str:
    """A chain in words: what it was taken for."""
    return (
        f"{chain['name']} ({chain['kind']}, {chain['links']} links on {chain['hangs_on']}, turns {chain['limit']:g} "
        f"degrees, stiffness {chain['stiffness']:g}, damping {chain['damping']:g})"
    )
