"""In which unit the lengths of a file are, and the character in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.core.character import Character
from bunraku.core.saving import provided
from bunraku.errors import OptionError, WeightsError
from bunraku.formats.frames import BARE, UNITS, likely_unit
from bunraku.formats.gltf.turning import scaled

__all__ = ["CHOICES", "NAMES", "SettledUnit", "check_unit", "in_metres", "resolve_unit"]

CHOICES = ("auto", "m", "cm", "mm", "in")
NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "": "unknown"}


@dataclass(frozen=True)
class SettledUnit:
    """How long the unit of a file is taken to be.

    Args:
        unit: One of `formats.frames.UNITS`.
        likely: What the height makes likely; "" where it is so small that nothing is.
        note: What to tell about it, without what to do; "" where there is nothing to tell.
    """

    unit: str
    likely: str
    note: str = ""


def check_unit(unit: str, option: str = "unit") -> None:
    """Raise OptionError unless this is a unit of characters or "auto"."""
    if unit not in CHOICES:
        raise OptionError(f"{option}: '{unit}' is no unit of characters; there are {', '.join(CHOICES)}")


def resolve_unit(height: float, suffix: str, unit: str = "auto") -> SettledUnit:
    """The unit of a character's file, from what is said about it, the rule of its format, and its height.

    Args:
        height: Its height as it was read, in metres where its format has a unit.
        suffix: The format; "" for a character of no file, which is in metres.
        unit: One of `CHOICES`. All but "auto" is taken for the unit of lengths as they were read.
    """
    likely, bare = likely_unit(height), suffix in BARE
    if unit != "auto":
        return SettledUnit(unit, likely)
    if likely == "m":
        return SettledUnit("m", likely)
    if not likely:
        return SettledUnit(
            "m", likely, f"{height:.2g} m tall: probably shrunk 100 or 1,000 times on its way; left as it is"
        )
    size = f"{height:,.4g} {'' if bare else 'm '}tall: probably {NAMES[likely]}"
    if bare:
        return SettledUnit(likely, likely, f"{size}; taken as {height * UNITS[likely]:.3g} m")
    return SettledUnit("m", likely, f"{size}, against the unit of its format; left as it is")


def in_metres(character: Character, unit: str = "auto", up: str | None = None) -> tuple[Character, str]:
    """The character in metres, and what there is to tell about it.

    Args:
        character: As its file has it, lying or standing.
        unit: One of `CHOICES`.
        up: Its up axis where that is known. Where it is not, and the unit hangs on it, it is guessed from the shape.

    Raises:
        OptionError: It is none of them, or the unit of the file cannot be changed.
    """
    check_unit(unit)
    suffix = str(getattr(character.source, "suffix", ""))
    resolved = resolve_unit(_height(character, up, suffix if unit == "auto" else ""), suffix, unit)
    factor = UNITS[resolved.unit]
    return character if factor == 1 else scaled(character, factor), resolved.note if suffix in BARE else ""


def _height(character: Character, up: str | None, suffix: str) -> float:
    extents = np.ptp(character.vertices[character.surface], axis=0)
    if up is None and suffix in BARE and len({likely_unit(float(extent)) for extent in extents}) > 1:
        try:
            up = provided("resolve_axes")(character).up
        except WeightsError:
            up = None  # as it is read then, with +Y up
    return float(extents["xyz".index((up or "+y")[1])]) or character.height
