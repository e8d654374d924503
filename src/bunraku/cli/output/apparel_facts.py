"""What `bunraku inspect` tells of bones of hair and clothes whose file says nothing of physics: the chains that they
become, and what is guessed of each.
"""

from __future__ import annotations

from typing import Any

from bunraku.core.character import Character

__all__ = ["apparel_facts", "say_chain"]


def apparel_facts(character: Character) -> dict[str, Any]:
    """The chains of a character's bones; nothing where its file says how apparel moves, or there are none."""
    import numpy as np

    from bunraku.physics.chains.from_bones import bone_chains
    from bunraku.physics.from_file import apparel_rig

    if character.rig is None or apparel_rig(character) is not None:
        return {}
    chains = bone_chains(character)
    if not chains:
        return {}
    return {
        "chains": [
            {
                "name": chain.name, "kind": chain.kind, "links": len(chain), "length": round(chain.length, 4),
                "hangs_on": character.rig.names[chain.holder],
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
