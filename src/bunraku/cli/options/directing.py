"""The options `--pin` and `--path`: where hands, feet and the root go."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated

import tyro

from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.ground_path import GroundPath
    from bunraku.retarget.stages.pins import Pin

__all__ = ["PathOption", "PinOption", "parse_path", "parse_pin"]

PinOption = Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART@TIME=X,Y,Z"), tyro.conf.UseAppendAction]
PathOption = Annotated[str, tyro.conf.arg(metavar="'X,Z X,Z ...'")]
_PIN = re.compile(r"(?P<part>[a-z_-]+)@(?P<time>[^=+]+)(\+(?P<hold>[^=]+))?=(?P<place>.+)")


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
            f"--pin is a part, a time and a place in metres, such as left_hand@2.0=0.3,1.4,0.2 (parts: "
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
            place, at, time = word.partition("@")
            x, z = _numbers(place, 2)
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
