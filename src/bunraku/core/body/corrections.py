"""What a person says about a character where guesses are wrong: a small TOML file beside the mesh."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

from bunraku.core.body.layout import HANDLE_INDEX
from bunraku.core.files import atomic_write, read_bounded
from bunraku.core.geometry.axes import axis_name
from bunraku.core.request import Limit, from_json
from bunraku.errors import FormatError, OptionError

SUFFIX = ".body.toml"
"""hero.body.toml corrects hero.glb."""
Kind = Literal[
    "body", "arm", "leg", "head", "tail", "wing", "hair", "prop", "ground", "skirt", "cape", "sleeve", "accessory"
]
"""What a piece can be: hair goes with the head, props and accessories with what they touch; clothes swing."""
CLOTHES = ("skirt", "cape", "sleeve")
"""Kinds that change nothing of the body below them."""
_Metres = Annotated[float, Limit("a coordinate", -1e6, 1e6)]  # by definition: farther out a float32 is too coarse
Point = tuple[_Metres, _Metres, _Metres]


@dataclass(frozen=True)
class Piece:
    """A piece of the surface and its kind."""

    kind: Kind  # what it is
    # points on or near it [m]; each stands for the loose part there, as far as one limb is taken to reach on it
    at: tuple[Point, ...]

    def __post_init__(self) -> None:
        if not self.at:
            raise OptionError("'at' needs at least one point, such as [[0.1, 1.2, 0.3]]")


@dataclass(frozen=True)
class Corrections:
    """What is said about a character. Positions are in metres with +Y up and facing +Z, as Bunraku shows it."""

    # up, front: axes of the file, or "auto"
    up: str = "auto"
    front: str = "auto"
    # which one of several characters moves, from 1, the largest
    character: Annotated[int | None, Limit("character", 1, 1000)] = None
    joints: dict[str, Point] = field(default_factory=dict)  # positions of joints by the names of their handles [m]
    part: tuple[Piece, ...] = ()  # pieces and their kinds, the later ones stronger

    def __post_init__(self) -> None:
        axes = [axis_name(axis) for axis in (self.up, self.front) if axis != "auto"]
        if len(axes) == 2 and axes[0][1] == axes[1][1]:
            raise OptionError("up and front lie along the same axis; choose two at a right angle")
        for name in self.joints:
            base, _, number = name.rpartition("_")
            if name not in HANDLE_INDEX and not (base in HANDLE_INDEX and number.isdecimal()):
                raise OptionError(f"there is no joint '{name[:40]}'; there are {', '.join(HANDLE_INDEX)}")

    @property
    def has_axes(self) -> bool:
        """Whether they say how the file stands."""
        return (self.up, self.front) != ("auto", "auto")

    @property
    def changes_body(self) -> bool:
        """Whether they say something about joints or pieces."""
        return bool(self.joints or self.part)

    def standing(self) -> Corrections:
        """The same for the character once it stands."""
        return replace(self, up="auto", front="auto") if self.has_axes else self


def read_corrections(path: Path) -> Corrections | None:
    """The corrections in the file beside a character's; None where there is none, FormatError where it is broken."""
    beside = path.with_name(f"{path.stem}{SUFFIX}")
    if not beside.is_file():
        return None
    try:
        return from_json(Corrections, tomllib.loads(read_bounded(beside).decode("utf-8-sig")), "the file")
    except OptionError as error:
        raise FormatError(beside, str(error)) from None
    except (ValueError, RecursionError) as error:  # bytes, TOML, or a number of thousands of digits
        raise FormatError(beside, f"this is not TOML ({str(error)[:80]}); correct it") from None


def write_corrections(
    path: Path,
    said: Corrections,
    axes: tuple[str, str],
    joints: Mapping[str, Sequence[float]],
    pieces: Sequence[tuple[str, Sequence[float]]],
) -> None:
    """Write a file of corrections: what is said, and every guess as a comment, to be changed. FormatError if it cannot
    be written.

    Args:
        axes: Up and front as they are taken.
        joints: Positions of all joints [m], by their names.
        pieces: Kind of each piece that is found, and a point on it [m].
    """

    def numbers(point: Sequence[float]) -> str:
        return f"[{', '.join(f'{float(value):.4f}' for value in point)}]"

    lines = [
        "# What this character is taken for. Remove the sign # before a line that you change.",
        "# Axes are those of the file. Positions are in metres, with +Y up and facing +Z.",
    ]
    for name, value, taken in (("up", said.up, axes[0]), ("front", said.front, axes[1])):
        lines.append(f'{"# " * (value == "auto")}{name} = "{taken if value == "auto" else value}"')
    lines += [f"{'# ' * (said.character is None)}character = {said.character or 1}  # of several, 1 is the largest"]
    lines += ["", "[joints]"]
    for name, point in {**joints, **said.joints}.items():
        lines.append(f"{'# ' * (name not in said.joints)}{name} = {numbers(point)}")
    for piece in said.part:
        points = ", ".join(map(numbers, piece.at))
        lines += ["", "[[part]]", f"kind = {json.dumps(piece.kind)}", f"at = [{points}]"]
    lines += ["", "# Kinds: " + ", ".join(get_args(Kind))]
    for kind, point in pieces:
        lines += ["# [[part]]", f"# kind = {json.dumps(kind)}", f"# at = [{numbers(point)}]"]
    with atomic_write(path) as file:
        file.write(("\n".join(lines) + "\n").encode())
