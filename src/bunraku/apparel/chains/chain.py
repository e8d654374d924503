"""A chain of links that swings, the parameters of each kind of chain, and a file beside the character's that changes
them.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.anatomy.names.bone_words import APPAREL_KINDS
from bunraku.apparel.mask import file_beside
from bunraku.core.character import Character
from bunraku.core.files import atomic_write, read_bounded
from bunraku.errors import FormatError

__all__ = [
    "Chain", "ChainParameters", "KINDS", "SUFFIX", "parameters_beside", "parameters_from_file", "parameters_of",
    "parameters_of_laid", "with_parameters", "write_parameters",
]  # fmt: skip

KINDS = (*APPAREL_KINDS, "strand")
"""Kinds of chains; a strand is one of which nothing is known."""


@dataclass(frozen=True)
class ChainParameters:
    """How a chain swings.

    Args:
        limit: How far a link turns against the one above it [rad].
        inward: How far of that it turns towards the body, as a share.
        stiffness: Spring of a link, over the moment of the weight that hangs on it; 0 for none.
        damping: Share of the velocity that is lost in a second.
        mass: Of the first link [kg]; those below are lighter, the last has half.
        gravity: Factor on gravity.
        root: Of its limits, what the first link has; those below have more, the last all of them.
    """

    limit: float
    inward: float
    stiffness: float
    damping: float
    mass: float = 0.5
    gravity: float = 1.0
    root: float = 1.0

    def turned(self, stiffness: float = 1.0, gravity: float = 1.0) -> ChainParameters:
        """As a user's dials ask: springs so many times as stiff and limits narrower by the root of that, gravity so
        many times as strong.
        """
        narrow = float(np.clip(stiffness, 0.01, 100.0) ** -0.5)
        return replace(
            self, stiffness=self.stiffness * stiffness, limit=min(self.limit * narrow, 1.4),
            gravity=self.gravity * gravity,
        )  # fmt: skip


# Limits and damping are medians of twelve MMD and VRM files and of the wardrobe: hair and tails turn 10 to 35 degrees,
# cloth 15 to 50, little hard pieces 5 to 15, and 0.8 to 0.99 of the velocity is lost in a second.
_DEGREE = np.pi / 180
_PARAMETERS = {
    "hair": ChainParameters(22 * _DEGREE, 0.6, 0.6, 0.93),
    "skirt": ChainParameters(32 * _DEGREE, 0.25, 0.35, 0.93),
    "cape": ChainParameters(32 * _DEGREE, 0.35, 0.2, 0.93),
    "sleeve": ChainParameters(25 * _DEGREE, 1.0, 0.5, 0.93),
    "tail": ChainParameters(22 * _DEGREE, 1.0, 1.0, 0.93),
    "ear": ChainParameters(12 * _DEGREE, 1.0, 3.0, 0.95),
    "ribbon": ChainParameters(30 * _DEGREE, 0.5, 0.4, 0.93, mass=0.25),
    "strand": ChainParameters(18 * _DEGREE, 0.8, 0.8, 0.93),
}

# Of chains that are laid over a shape: what came nearest to the simulated wardrobe, kind by kind, on 18 characters for
# training. There shape says nothing of limits and springs beyond the kind (a regression on length, width, place, number
# and direction explains 1 % of the limits' variance on held-out characters), so they are guessed on the narrow side.
_LAID = {
    "hair": ChainParameters(12 * _DEGREE, 1.0, 0.3, 0.93),
    "skirt": ChainParameters(13 * _DEGREE, 1.0, 0.3, 0.88),
    "cape": ChainParameters(15 * _DEGREE, 1.0, 0.3, 0.9),
    "sleeve": ChainParameters(8 * _DEGREE, 1.0, 0.3, 0.95),
    "tail": ChainParameters(9 * _DEGREE, 1.0, 0.3, 0.9),
    "ear": ChainParameters(5 * _DEGREE, 1.0, 1.0, 0.95),
    "ribbon": ChainParameters(10 * _DEGREE, 1.0, 0.4, 0.93, mass=0.25),
    "strand": ChainParameters(10 * _DEGREE, 1.0, 0.4, 0.93),
}
LONG = 0.15
"""Of the size [m]: shorter chains hold their shape more."""
SHORT_SHARE = 0.4  # of its limits, that the shortest chain has at least
ROOT = 0.5  # of its limits, that the first link of a chain has


def parameters_of_laid(kind: str, length: float) -> ChainParameters:
    """How a chain swings that is laid over a shape.

    Args:
        kind: One of `KINDS`.
        length: Over the size of the character.
    """
    manner = _LAID[kind]
    return replace(manner, limit=manner.limit * float(np.clip(length / LONG, SHORT_SHARE, 1.0)), root=ROOT)


def parameters_of(kind: str) -> ChainParameters:
    """How apparel of a kind swings where nothing more is known of it."""
    return _PARAMETERS[kind]


@dataclass(frozen=True, eq=False)
class Chain:
    """R links in a row.

    Args:
        name: Of its first bone.
        kind: One of `KINDS`.
        bones: Bone of the rig that each link is, shape (R,).
        points: Where the links begin, and where the last one ends [m], shape (R + 1, 3).
        holder: The bone that it hangs on; a link of another chain where it branches off.
        width: Half the width of what each link holds [m], shape (R,).
        thick: Half its thickness [m].
        manner: How it swings.
    """

    name: str
    kind: str
    bones: np.ndarray
    points: np.ndarray
    holder: int
    width: np.ndarray
    thick: float
    manner: ChainParameters

    @property
    def length(self) -> float:
        """From its first point along its links to the last [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def __len__(self) -> int:
        return len(self.bones)


SUFFIX = ".apparel.toml"
_BOUNDS = {"limit": (0.0, 90.0), "stiffness": (0.0, 1000.0), "damping": (0.0, 0.999), "gravity": (-10.0, 10.0),
           "mass": (1e-3, 1000.0)}  # fmt: skip


def parameters_beside(character: Character) -> dict[str, dict[str, float]]:
    """What the file beside a character's says, by kinds and names of chains; nothing where there is none.

    Raises:
        FormatError: It is broken, or says what is not known.
    """
    path = file_beside(character, (SUFFIX,))
    return {} if path is None else _read(path)


def with_parameters(chains: Sequence[Chain], told: Mapping[str, Mapping[str, float]]) -> tuple[Chain, ...]:
    """Chains that swing as is told: by their kind, and then by the longest beginning of their name that is told."""
    out = []
    for chain in chains:
        own = parameters_from_file(chain.kind, chain.name, told)
        if "limit" in own:
            own["limit"] = float(np.radians(own["limit"]))
        out.append(replace(chain, manner=replace(chain.manner, **own)) if own else chain)
    return tuple(out)


def parameters_from_file(kind: str, name: str, told: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """What is told of a chain, in the numbers of the file.

    Args:
        kind: One of `KINDS`.
        name: Of the chain.
        told: By kinds and by what names begin with.
    """
    own: dict[str, float] = dict(told.get(kind, {}))
    for begin in sorted(told, key=len):
        if begin not in KINDS and name.startswith(begin):
            own |= told[begin]
    return own


def write_parameters(chains: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write such a file to start from: a table for each chain, in which every guess is a comment, so that it changes
    nothing until somebody takes the sign away.

    Args:
        chains: Name, kind, links, what it hangs on (`hangs_on`), and the numbers of each.
        path: The file.

    Raises:
        FormatError: It cannot be written.
    """
    lines = ["# How apparel swings. Take away the sign # before what is to count, and change the number."]
    for chain in chains:
        name, holder = (json.dumps(str(chain[key]), ensure_ascii=False) for key in ("name", "hangs_on"))
        lines += ["", f"[{name}]  # {chain['kind']}, {chain['links']} links on {holder}"]
        lines += [f"# {key} = {float(chain[key]):.4g}" for key in _BOUNDS]
    with atomic_write(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _read(path: Path) -> dict[str, dict[str, float]]:
    try:
        tables: dict[str, Any] = tomllib.loads(read_bounded(path).decode("utf-8-sig"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise FormatError(path, f"this is no TOML ({str(error)[:80]}); correct it") from None
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise FormatError(path, f"'{name[:40]}' stands outside of a table; put it below [hair], [skirt] or a name")
        for key, value in table.items():
            low, high = _BOUNDS.get(key, (1.0, 0.0))
            if low > high:
                raise FormatError(path, f"'{key[:40]}' of [{name[:40]}] is not known; it has {', '.join(_BOUNDS)}")
            if type(value) not in (int, float) or not low <= value <= high:
                raise FormatError(path, f"'{key}' of [{name[:40]}] must be a number from {low:g} to {high:g}")
    return tables
