"""The options of constraints: loops, what is followed, where hands, feet and the root go."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.errors import OptionError
from bunraku.pipelines.requests.constraints import Constraints

if TYPE_CHECKING:
    from bunraku.core.ground_path import GroundPath
    from bunraku.retarget.stages.pins import Pin

__all__ = ["DirectingOptions", "PinOption", "parse_path", "parse_pin"]

PinOption = Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART@TIME=X,Y,Z"), tyro.conf.UseAppendAction]
PathOption = Annotated[str, tyro.conf.arg(metavar="'X,Z X,Z ...'")]
_PIN = re.compile(r"(?P<part>[a-z_-]+)@(?P<time>[^=+]+)(\+(?P<hold>[^=]+))?=(?P<place>.+)")


@dataclass(frozen=True)
class DirectingOptions:
    """Constraints of a motion on the command line."""

    loop: bool = False
    """Make a loop: the clip ends in the pose that it starts in, at the same speed."""
    in_place: bool = False
    """Take the travel over the ground out: the character walks on the spot."""
    after: Path | None = None
    """A .glb or .npz clip of Bunraku: start in its last pose."""
    path: PathOption = ""
    """Points on the ground that the root passes, x and z in metres from where the clip starts to where it ends, such as
    "0,0 1,2 3,2"; with "@SECONDS" behind each where times matter.
    """
    pin: PinOption = ()
    """Where the wrist of a hand or the ankle of a foot is at a time, such as left_hand@2.0=0.3,1.4,0.2: left_hand,
    right_hand, left_foot or right_foot, seconds (+ seconds for which it is held), x, y and z in metres. May be given
    more than once.
    """

    def constraints(self) -> Constraints:
        """The constraints; what is followed is named by its file.

        Raises:
            OptionError: A text is no path or no pin.
        """
        return Constraints.of(
            loop=self.loop, in_place=self.in_place, after=None if self.after is None else str(self.after),
            path=parse_path(self.path), pins=[parse_pin(pin) for pin in self.pin],
        )  # fmt: skip


def _numbers(text: str, count: int) -> tuple[float, ...]:
    values = tuple(float(value) for value in text.split(","))
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise ValueError
    return values


def parse_pin(text: str) -> Pin:
    """The pin of "left_hand@2.0=0.3,1.4,0.2", or "left_hand@2.0+0.5=0.3,1.4,0.2", which is held for half a second.

    Raises:
        OptionError: It is no such text.
    """
    from bunraku.retarget.stages.pins import PINNED, Pin

    found = _PIN.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError
        x, y, z = _numbers(found["place"], 3)
        return Pin(found["part"].replace("-", "_"), float(found["time"]), (x, y, z), None, float(found["hold"] or 0))
    except ValueError:
        raise OptionError(
            f"--pin is a part, a time and a position in metres, such as left_hand@2.0=0.3,1.4,0.2 (parts: "
            f"{', '.join(PINNED)}), not '{text}'"
        ) from None


def parse_path(text: str) -> GroundPath | None:
    """The path of "0,0 1,2 3,2", or "0,0@0 1,2@2.5" with the seconds at which each point is passed; None for "".

    Raises:
        OptionError: It is no such text.
    """
    from bunraku.core.ground_path import GroundPath

    if not text.strip():
        return None
    points: list[tuple[float, float]] = []
    times: list[float] = []
    try:
        for word in text.split():
            coordinates, at, time = word.partition("@")
            x, z = _numbers(coordinates, 2)
            points.append((x, z))
            if at:
                times.append(float(time))
        if times and len(times) != len(points):
            raise ValueError
    except ValueError:
        raise OptionError(
            f"--path is points on the ground with x and z in metres, such as '0,0 1,2 3,2', all or none with their "
            f"seconds (1,2@2.5), not '{text}'"
        ) from None
    return GroundPath(tuple(points), tuple(times) if times else None)
