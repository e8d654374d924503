"""How a character of a file is taken to stand: by the rule of its format, by its bones, by its shape."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.core.character import Character
from bunraku.handles.orientation import ResolvedAxes, resolve_axes
from bunraku.handles.orientation_evidence import has_rule

__all__ = ["FileStanding", "file_standing"]


@dataclass(frozen=True)
class FileStanding:
    """How a character is taken to stand.

    Args:
        resolved: Its axes, and the guess by its shape where one was made.
        rule: Whether its format says how it stands, and nobody said otherwise.
        bones: The horizontal axis that its bones face, where the rule holds and they tell; "" otherwise.
    """

    resolved: ResolvedAxes
    rule: bool = False
    bones: str = ""


def file_standing(character: Character, up: str = "auto", front: str = "auto") -> FileStanding:
    """How a character of a file is taken to stand.

    Where the format has a rule and no option says otherwise, the rule holds as long as its bones agree, or where there
    are none, as long as the guess is not sure of something else.

    Args:
        character: As the file has it.
        up: The axis that is up in it, such as "+z"; "auto" guesses.
        front: The axis that it faces; "auto" guesses.

    Raises:
        OptionError: These are not two axes at a right angle.
        WeightsError: Something is to be guessed and the weights are missing or broken.
    """
    resolved = resolve_axes(character, up, front)
    unsaid = up.strip().lower() == front.strip().lower() == "auto"
    rule = has_rule(getattr(character.source, "suffix", "")) and unsaid
    bones = _front_of_bones(character) if rule else ""
    return FileStanding(ResolvedAxes("+y", "+z", resolved.guess) if bones else resolved, rule, bones)


def _front_of_bones(character: Character) -> str:
    """The horizontal axis that a rig with +Y up faces; "" where there is none or the bones do not say."""
    rig = character.rig
    if rig is None:
        return ""
    from bunraku.skeletons.rig_axes import rig_axes

    axes = rig_axes(rig.names, rig.parents, rig.positions)
    return axes[1] if axes and axes[0] == "+y" else ""
