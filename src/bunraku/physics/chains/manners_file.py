"""How chains swing, as somebody wrote it down in a file beside the character's: `gene.apparel.toml` for `gene.pmx`.

[hair]              # a kind of chain, or what the name of a chain begins with
limit = 12          # how far a link turns [degrees]
stiffness = 0.5     # spring, over the weight that hangs on it
damping = 0.9       # share of the velocity lost in a second
gravity = 1.0
mass = 0.5          # of the first link [kg]
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.artist_mask import file_beside
from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write, read_bounded
from bunraku.physics.chains.chain import KINDS, Chain

__all__ = ["SUFFIX", "manners_beside", "told_of", "with_manners", "write_manners"]

SUFFIX = ".apparel.toml"
_BOUNDS = {"limit": (0.0, 90.0), "stiffness": (0.0, 1000.0), "damping": (0.0, 0.999), "gravity": (-10.0, 10.0),
           "mass": (1e-3, 1000.0)}  # fmt: skip


def manners_beside(character: Character) -> dict[str, dict[str, float]]:
    """What the file beside a character's says, by kinds and names of chains; nothing where there is none.

    Raises:
        FormatError: It is broken, or says what is not known.
    """
    path = file_beside(character, (SUFFIX,))
    return {} if path is None else _read(path)


def with_manners(chains: Sequence[Chain], told: Mapping[str, Mapping[str, float]]) -> tuple[Chain, ...]:
    """Chains that swing as is told: by their kind, and then by the longest beginning of their name that is told."""
    out = []
    for chain in chains:
        own = told_of(chain.kind, chain.name, told)
        if "limit" in own:
            own["limit"] = float(np.radians(own["limit"]))
        out.append(replace(chain, manner=replace(chain.manner, **own)) if own else chain)
    return tuple(out)


def told_of(kind: str, name: str, told: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
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


def write_manners(chains: Sequence[Mapping[str, Any]], path: Path) -> None:
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
