"""The options `--up`, `--front` and `--unit`, and what is said about a character that does not stand as it should or
whose size makes no sense.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.character import Character
    from bunraku.handles.orientation import ResolvedAxes

__all__ = ["AxisOption", "UnitOption", "check_axes", "said_axes", "resolve_file", "stand_up", "stands_line"]

AxisOption = Annotated[str, tyro.conf.arg(metavar="{auto,+x,-x,+y,-y,+z,-z}")]
UnitOption = Literal["auto", "m", "cm", "mm", "in"]
OPTIONS = ("--up", "--front")


def check_axes(up: str, front: str) -> None:
    """Raise OptionError unless these are axes at a right angle, or "auto"."""
    from bunraku.geometry.axes import axis_name

    names = {}
    for option, value in zip(OPTIONS, (up, front), strict=True):
        if value.strip().lower() != "auto":
            try:
                names[option] = axis_name(value)
            except OptionError as error:
                raise OptionError(f"{option}: {error}, or auto") from None
    if len(names) == 2 and names["--up"][1] == names["--front"][1]:
        raise OptionError(
            f"--up {names['--up']} and --front {names['--front']} lie along the same axis; choose two at a right angle"
        )


def stand_up(character: Character, path: Path, up: str = "auto", front: str = "auto", unit: str = "auto") -> Character:
    """The character in metres, standing along +Y and facing +Z; lines on standard error say what was guessed.

    Args:
        character: As the file has it.
        path: The file.
        up, front, unit: What the options say.

    Raises:
        OptionError: The unit of the file cannot be changed.
        WeightsError: Something is to be guessed and the weights are missing or broken.
    """
    from bunraku.formats.gltf.turning import turned
    from bunraku.io.units import in_metres

    resolved, line = resolve_file(character, up, front)
    if line:
        print(f"{path}: {line}", file=sys.stderr)
    if (resolved.up, resolved.front) != ("+y", "+z"):
        character = turned(character, resolved.up, resolved.front)
    character, note = in_metres(character, unit, "+y")
    if note:
        print(f"{path}: {note}. Type --unit m to keep its numbers.", file=sys.stderr)
    return character


def resolve_file(character: Character, up: str = "auto", front: str = "auto") -> tuple[ResolvedAxes, str]:
    """How a character of a file is taken to stand, and what there is to say about it."""
    from bunraku.handles.orientation import resolve_axes

    resolved = resolve_axes(character, up, front)
    return resolved, said_axes(resolved, up, front)


def stands_line(character: Character, up: str = "auto", front: str = "auto") -> str:
    """How a character of a file is taken to stand and how sure that is, in one line.

    Args:
        character: As the file has it.
        up, front: What the options say.
    """
    resolved, note = resolve_file(character, up, front)
    taken = f"stands with {resolved.up.upper()} up, facing {resolved.front.upper()}"
    guess = resolved.guess
    if guess is None:
        return f"{taken}, as told"
    sure = _percent(guess.probability(resolved.up, resolved.front))
    return f"{taken} ({sure} sure)" + (f" - {note}" if note else "")


def said_axes(resolved: ResolvedAxes, up: str = "auto", front: str = "auto") -> str:
    """What to tell about a guess: what was taken, how sure that is, and what to type to set it.

    Nothing where nothing was guessed, and nothing where it is at least 85 % sure.

    Args:
        resolved: How the character is taken to stand.
        up, front: What the options say.
    """
    from bunraku.handles.orientation import SURE

    guess = resolved.guess
    if guess is None:
        return ""
    given = [value.strip().lower() != "auto" for value in (up, front)]
    taken = (resolved.up, resolved.front)
    chance = guess.probability(*taken)
    if chance >= SURE:
        return ""
    other = (guess.up, guess.front) if taken != (guess.up, guess.front) else guess.next_best(*taken)
    return (
        f"taken as {_listed(taken, given)} ({_percent(chance)} sure), perhaps {_listed(other, given)} "
        f"({_percent(guess.probability(*other))}). To set it, type {_typed(taken, given)}, or else "
        f"{_typed(other, given)}; `bunraku inspect FILE --views views.png` shows which."
    )


def _percent(chance: float) -> str:
    return f"{100 * min(chance, 0.99):.0f} %"


def _listed(axes: tuple[str, str], given: list[bool]) -> str:
    words = (f"{axes[0].upper()} up", f"facing {axes[1].upper()}")
    return ", ".join(word for word, said in zip(words, given, strict=True) if not said)


def _typed(axes: tuple[str, str], given: list[bool]) -> str:
    """The options that say these axes, those that are not given."""
    return " ".join(f"{option} {axis}" for option, axis, said in zip(OPTIONS, axes, given, strict=True) if not said)
