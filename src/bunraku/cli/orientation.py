"""The options `--up` and `--front`, and what is said about a character that does not stand as it should."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.character import Character
    from bunraku.handles.orientation import Settled

__all__ = ["AxisOption", "check_axes", "said_axes", "settle_file", "stand_up"]

AxisOption = Annotated[str, tyro.conf.arg(metavar="{auto,+x,-x,+y,-y,+z,-z}")]
OPTIONS = ("--up", "--front")
SILENT = (".obj", ".ply", ".stl")
"""Formats that do not say which axis is up; the others have a rule, and a guess does not overrule it."""


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


def stand_up(character: Character, path: Path, up: str = "auto", front: str = "auto") -> Character:
    """The character standing along +Y and facing +Z; one line on standard error says what was guessed.

    Args:
        character: As the file has it.
        path: The file.
        up, front: What the options say.

    Raises:
        WeightsError: Something is to be guessed and the weights are missing or broken.
    """
    from bunraku.formats.turning import turned

    settled, line = settle_file(character, up, front)
    if line:
        print(f"{path}: {line}", file=sys.stderr)
    return turned(character, settled.up, settled.front)


def settle_file(character: Character, up: str = "auto", front: str = "auto") -> tuple[Settled, str]:
    """How a character of a file is taken to stand, and what there is to say about it.

    Where the format has a rule and no option says otherwise, the rule holds, and a guess that is sure of something else
    is told.
    """
    from bunraku.handles.orientation import SURE, settle

    rule = (
        getattr(character.source, "suffix", ".obj") not in SILENT
        and up.strip().lower() == front.strip().lower() == "auto"
    )
    settled = settle(character, up, front, sure=math.inf if rule else SURE)
    guess = settled.guess
    if not rule or guess is None:
        return settled, said_axes(settled, up, front)
    bones = _front_of_bones(character)
    if bones not in ("", settled.front):
        return (
            settled,
            f"its bones face {bones.upper()}, if left and right are named rightly; left as it is. Say --front {bones} "
            "to turn it.",
        )
    if guess.confidence < SURE or (guess.up, guess.front) == (settled.up, settled.front):
        return settled, ""
    seen = f"{guess.up.upper()} up and face {guess.front.upper()} ({_percent(guess.confidence)} sure)"
    return (
        settled,
        f"seems to have {seen}, against the rule of its format; left as it is. Say --up and --front to turn it.",
    )


def _front_of_bones(character: Character) -> str:
    """The horizontal axis that a rig with +Y up faces; "" where there is none or the bones do not say."""
    from bunraku.skeletons.rig_axes import rig_axes

    rig = character.rig
    axes = None if rig is None else rig_axes(rig.names, rig.parents, rig.positions)
    return axes[1] if axes and axes[0] == "+y" else ""


def said_axes(settled: Settled, up: str = "auto", front: str = "auto") -> str:
    """What to tell about a guess: nothing where there was none, and nothing where the character stands as is usual.

    Args:
        settled: How the character is taken to stand.
        up, front: What the options say.
    """
    from bunraku.geometry.axes import default_orientation
    from bunraku.handles.orientation import MAYBE

    guess, options = (
        settled.guess,
        [option for option, value in zip(OPTIONS, (up, front), strict=True) if value.strip().lower() == "auto"],
    )
    if guess is None:
        return ""
    usual = default_orientation(
        *(
            None if option in options else axis
            for option, axis in zip(OPTIONS, (settled.up, settled.front), strict=True)
        )
    )
    turned = (settled.up, settled.front) != usual
    if (guess.up, guess.front) == usual or not (turned or guess.confidence >= MAYBE):
        return ""
    words = []
    if "--up" in options:
        words.append(f"have {guess.up.upper()} up ({_percent(guess.up_confidence)} sure)")
    if "--front" in options and (not turned or settled.front == guess.front):
        words.append(f"face {guess.front.upper()} ({_percent(guess.front_confidence)} sure)")
    verdict = "turned" if turned else f"taken as {settled.up.upper()} up, facing {settled.front.upper()}"
    return (
        f"{'seems to' if turned else 'may'} {' and '.join(words)}; {verdict}. Say {' and '.join(options)} to settle it."
    )


def _percent(share: float) -> str:
    return f"{100 * min(share, 0.99):.0f} %"
