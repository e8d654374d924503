"""A chain of links that swings, the parameters of each kind, and a file beside the character's that changes them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.anatomy.names.bone_words import APPAREL_KINDS
from bunraku.apparel.clothed import BESIDE
from bunraku.apparel.mask import file_beside
from bunraku.core.character import Character
from bunraku.core.files import atomic_write, read_bounded
from bunraku.errors import FormatError

KINDS = (*APPAREL_KINDS, "strand")  # kinds of chains; nothing is known of a strand


@dataclass(frozen=True)
class ChainParameters:
    """How a chain swings."""

    limit: float  # how far a link rotates against the one above it [rad]
    inward: float  # share of the limit towards the body
    stiffness: float  # spring of a link, over the moment of the weight that hangs on it; 0 for none
    damping: float  # share of the velocity that is lost in a second
    mass: float = 0.5  # of the first link [kg]; links below are lighter, the last has half
    gravity: float = 1.0  # factor on gravity
    root: float = 1.0  # share of the limits that the first link has; it rises to 1 at the last

    def turned(self, stiffness: float = 1.0, gravity: float = 1.0) -> ChainParameters:
        """With a user's factors on springs and gravity; limits are narrower by the root of the stiffness."""
        narrow = float(np.clip(stiffness, 0.01, 100.0) ** -0.5)
        return replace(
            self, stiffness=self.stiffness * stiffness, limit=min(self.limit * narrow, 1.4),
            gravity=self.gravity * gravity,
        )  # fmt: skip


# Limits and damping are medians of twelve MMD and VRM files and of the wardrobe: hair and tails turn 10 to 35 degrees,
# cloth 15 to 50, little hard pieces 5 to 15, and 0.8 to 0.99 of the velocity is lost in a second.
_PARAMETERS = {
    "hair": ChainParameters(np.radians(22), 0.6, 0.6, 0.93),
    "skirt": ChainParameters(np.radians(32), 0.25, 0.35, 0.93),
    "cape": ChainParameters(np.radians(32), 0.35, 0.2, 0.93),
    "sleeve": ChainParameters(np.radians(25), 1.0, 0.5, 0.93),
    "tail": ChainParameters(np.radians(22), 1.0, 1.0, 0.93),
    "ear": ChainParameters(np.radians(12), 1.0, 3.0, 0.95),
    "ribbon": ChainParameters(np.radians(30), 0.5, 0.4, 0.93, mass=0.25),
    "strand": ChainParameters(np.radians(18), 0.8, 0.8, 0.93),
}


@dataclass(frozen=True)
class LaidShape:
    """What is seen of a chain at rest that is laid over a shape."""

    length: float  # along it, over the size of the character
    slim: float  # its length over its width; infinite for a sheet
    gap: float  # how far it is from the body on the mean, over the size of the character
    down: float  # cosine of its direction and down: 1 where it hangs, 0 level, -1 where it stands

    @property
    def loose(self) -> float:
        """From 0, where nothing suggests that it swings, to 1, where it hangs freely and is slim."""
        hangs = 0.5 + 0.5 * self.down
        return float(hangs * np.clip(self.slim / SLIM, 0, 1) * np.clip(self.gap / BESIDE, 0, 1))

    @property
    def weight(self) -> float:
        """Factor on its gravity: what stands off at rest, a wide skirt, has its shape by itself."""
        return float(np.clip((self.down - ASLANT) / (1 - ASLANT), 0, 1))


# On the wardrobe's 18 characters for training, shape says nothing of limits beyond the kind (a regression explains 1 %
# of their variance): its springs are drawn without regard to it. What follows was chosen by eye, by strips in a hidden
# order of eight bare meshes.
_BEND = {"hair": 14.0, "skirt": 15.0, "cape": 30.0, "sleeve": 9.0, "tail": 12.0, "ear": 5.0, "ribbon": 11.0,
         "strand": 11.0}  # fmt: skip
"""How far a link of each kind rotates against the one above it [degrees], where it is half loose."""
SLIM = 4.0  # length over width from which on a lock is slim
ASLANT = 0.8  # cosine from which on a chain hangs at all
LONG = 0.15  # over the size; shorter chains hold their shape more
SHORT_SHARE = 0.4  # of its limits, that the shortest chain has at least
ROOT = 0.5  # of its limits, that the first link of a chain has
LOOSE = (0.6, 1.4)  # of its limits, that a chain has that is not loose at all, and one that is quite loose
HOLD = (0.5, 0.1)  # spring over the moment of its weight, the same
LOSS = (0.95, 0.89)  # share of the velocity lost in a second, the same


def parameters_of_laid(kind: str, shape: LaidShape) -> ChainParameters:
    """Parameters of a chain laid over a shape, by its kind (`KINDS`) and what is seen of it at rest.

    A skirt is drawn as its weight lets it hang, so that the same weight does not pull at it once more: a wide one would
    fall in on the legs.
    """
    limit, hold, loss = (first + shape.loose * (last - first) for first, last in (LOOSE, HOLD, LOSS))
    limit *= np.radians(_BEND[kind]) * float(np.clip(shape.length / LONG, SHORT_SHARE, 1.0))
    return ChainParameters(limit, 1.0, hold, loss, gravity=0.0 if kind == "skirt" else shape.weight, root=ROOT)


def parameters_of(kind: str) -> ChainParameters:
    """How apparel of a kind swings where nothing more is known of it."""
    return _PARAMETERS[kind]


@dataclass(frozen=True, eq=False)
class Chain:
    """R links in a row."""

    name: str  # of its first bone
    kind: str  # one of `KINDS`
    bones: np.ndarray  # bone of the rig that each link is, shape (R,)
    points: np.ndarray  # beginnings of the links, and the end of the last one [m], shape (R + 1, 3)
    holder: int  # the bone that it hangs on; a link of another chain where it branches off
    width: np.ndarray  # half the width of what each link holds [m], shape (R,)
    thick: float  # half its thickness [m]
    parameters: ChainParameters  # how it swings

    @property
    def length(self) -> float:
        """Along its links [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def limits(self) -> np.ndarray:
        """How far each link rotates against the one above it [rad], shape (R,)."""
        share = self.parameters.root + (1 - self.parameters.root) * np.arange(len(self)) / max(len(self) - 1, 1)
        return np.asarray(self.parameters.limit * share)

    def __len__(self) -> int:
        return len(self.bones)


SUFFIX = ".apparel.toml"
_BOUNDS = {"limit": (0.0, 90.0), "stiffness": (0.0, 1000.0), "damping": (0.0, 0.999), "gravity": (-10.0, 10.0),
           "mass": (1e-3, 1000.0)}  # fmt: skip
"""What a file may say, with room about what was measured on twelve MMD and VRM files (`_PARAMETERS`)."""


def parameters_beside(character: Character) -> dict[str, dict[str, float]]:
    """Parameters from the file beside a character's, by kinds and names of chains; empty where there is none.
    FormatError if it is broken, or has an unknown entry.
    """
    path = file_beside(character, (SUFFIX,))
    return {} if path is None else _read(path)


def with_parameters(chains: Sequence[Chain], tables: Mapping[str, Mapping[str, float]]) -> tuple[Chain, ...]:
    """Chains with parameters from a file: by kind, and then by the longest beginning of their names."""
    out = []
    for chain in chains:
        changes = parameters_from_file(chain.kind, chain.name, tables)
        if "limit" in changes:
            changes["limit"] = float(np.radians(changes["limit"]))
        out.append(replace(chain, parameters=replace(chain.parameters, **changes)) if changes else chain)
    return tuple(out)


def parameters_from_file(kind: str, name: str, tables: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Parameters of a chain in the units of the file, from tables by kinds and by beginnings of names."""
    changes: dict[str, float] = dict(tables.get(kind, {}))
    for begin in sorted(tables, key=len):
        if begin not in KINDS and name.startswith(begin):
            changes |= tables[begin]
    return changes


def write_parameters(chains: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a file of parameters to start from: a table for each chain, in which every guess is a comment, so that it
    changes nothing until a user removes the sign. FormatError if it cannot be written.

    Args:
        chains: Name, kind, links, what it hangs on (`hangs_on`), and the parameters of each.
        path: The file.
    """
    lines = ["# How apparel swings. Remove the sign # before a number that you change."]
    for chain in chains:
        name, holder = (json.dumps(str(chain[key]), ensure_ascii=False) for key in ("name", "hangs_on"))
        lines += ["", f"[{name}]  # {chain['kind']}, {chain['links']} links on {holder}"]
        lines += [f"# {key} = {float(chain[key]):.4g}" for key in _BOUNDS]
    with atomic_write(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _read(path: Path) -> dict[str, dict[str, float]]:
    try:
        tables: dict[str, Any] = tomllib.loads(read_bounded(path).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # bytes, TOML, or a number of thousands of digits
        raise FormatError(path, f"this is not TOML ({str(error)[:80]}); correct it") from None
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
