"""Characters made by code, each from a family and a seed: more shapes than any archive holds.

People of all proportions, dressed and armed; mascots; beasts on two and four legs; dragons, birds, fish, insects,
blobs. Their bones have names that `anatomy.names.bone_names` reads, so that every part has the handle that it has
on characters made by artists. They face +Z, stand on y = 0 (or hang above it) and have their left at +X. Meshes vary as
those of artists do: one skin, a skin for each limb, or many closed parts that cut through each other; many triangles or
few; soft weights or rigid ones.
"""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

import numpy as np

from bunraku.core.character import Character
from bunraku.errors import OptionError
from bunraku_lab.synthetic.families import beasts, bipeds, crawlers, people, sea, toons
from bunraku_lab.synthetic.families.model import Model

__all__ = ["EVALUATION_SEED", "FAMILIES", "code_made_character", "code_made_names"]

EVALUATION_SEED = 1_000_000
"""Seeds from here on are for evaluation; nothing trains on them."""

_MAKERS: dict[str, tuple[Callable[[Model], None], float]] = {
    "humanoid": (people.humanoid, 48),
    "mascot": (toons.mascot, 6),
    "blob": (toons.blob, 4),
    "flyer": (toons.flyer, 4),
    "quadruped": (beasts.quadruped, 12),
    "dragon": (beasts.dragon, 3),
    "frog": (beasts.frog, 2),
    "dinosaur": (bipeds.dinosaur, 4),
    "bird": (bipeds.bird, 4),
    "mech": (bipeds.mech, 3),
    "fish": (sea.fish, 5),
    "whale": (sea.whale, 1.5),
    "ray": (sea.ray, 1.5),
    "seahorse": (sea.seahorse, 0.5),
    "insect": (crawlers.insect, 1.5),
    "spider": (crawlers.spider, 2),
    "bee": (crawlers.bee, 2),
    "crab": (crawlers.crab, 1.5),
    "snake": (crawlers.snake, 1.5),
}

FAMILIES: tuple[str, ...] = tuple(_MAKERS)
"""Families that `code_made_character` knows."""


def code_made_character(family: str, seed: int) -> Character:
    """A rigged character, the same for the same family and seed.

    Args:
        family: One of `FAMILIES`.
        seed: Any whole number from 0; those from `EVALUATION_SEED` on are for evaluation.

    Raises:
        OptionError: The family is unknown or the seed negative.
    """
    if family not in FAMILIES:
        raise OptionError(f"there is no family of characters named {family!r}; choose one of {', '.join(FAMILIES)}")
    if seed < 0:
        raise OptionError(f"the seed of a character must be 0 or more, not {seed}")
    model = Model(np.random.default_rng([crc32(family.encode()), seed]))
    _MAKERS[family][0](model)
    return model.character(f"{family}_{seed}")


def code_made_names(count: int, seed: int = 0) -> list[tuple[str, int]]:
    """Family and seed of `count` characters, families by their shares; a longer list begins as a shorter one."""
    shares = np.array([share for _, share in _MAKERS.values()])
    owed, out = np.zeros(len(shares)), []
    for number in range(count):
        owed += shares / shares.sum()
        chosen = int(owed.argmax())
        owed[chosen] -= 1
        out.append((tuple(_MAKERS)[chosen], seed + number))
    return out
