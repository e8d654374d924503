"""What a request holds, checked: JSON within bounds, numbers within ranges, words of a list."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from starlette.requests import Request

from bunraku.errors import OptionError
from bunraku.studio.state import State

__all__ = ["body_of", "choice", "state_of", "number", "path_of", "sampling", "text", "things"]

MOST_JSON = 4 << 20
MOST_SEEDS = 8


def state_of(request: Request) -> State:
    """The state behind the routes."""
    state = request.app.state.studio if hasattr(request.app.state, "studio") else request.scope["app"].state.studio
    assert isinstance(state, State)
    return state


async def body_of(request: Request) -> dict[str, Any]:
    """The JSON object of a request.

    Raises:
        OptionError: It is none, or too large.
    """
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > MOST_JSON:
            raise OptionError(f"a request of more than {MOST_JSON >> 20} MiB is not taken")
    try:
        found = json.loads(bytes(data) or b"{}")
    except (ValueError, RecursionError):
        raise OptionError("the request is no JSON") from None
    if not isinstance(found, dict):
        raise OptionError("the request is no JSON object")
    return found


def number(body: dict[str, Any], name: str, low: float, high: float, default: float | None = None) -> Any:
    """A number of a request, or the default where it says nothing.

    Raises:
        OptionError: It is no number, or out of range.
    """
    value = body.get(name)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise OptionError(f"{name} must be a number")
    if not low <= value <= high:
        raise OptionError(f"{name} must be from {low:g} to {high:g}, not {value:g}")
    return value


def text(body: dict[str, Any], name: str, most: int, default: str = "") -> str:
    """A text of a request.

    Raises:
        OptionError: It is no text, or too long.
    """
    value = body.get(name, default)
    if not isinstance(value, str):
        raise OptionError(f"{name} must be a text")
    if len(value) > most:
        raise OptionError(f"{name} has more than {most} characters")
    return value


def choice(body: dict[str, Any], name: str, known: Sequence[str], default: str) -> str:
    """One of some words.

    Raises:
        OptionError: It is none of them.
    """
    value = body.get(name, default)
    if value not in known:
        raise OptionError(f"{name} is one of {', '.join(known)}")
    return str(value)


def things(body: dict[str, Any], name: str, most: int) -> list[Any]:
    """A list of a request.

    Raises:
        OptionError: It is no list, or too long.
    """
    value = body.get(name) or []
    if not isinstance(value, list):
        raise OptionError(f"{name} must be a list")
    if len(value) > most:
        raise OptionError(f"{name} has more than {most} entries")
    return value


def sampling(body: dict[str, Any]) -> dict[str, Any]:
    """How takes are drawn.

    Raises:
        OptionError: Something of it cannot be.
    """
    seeds = things(body, "seeds", MOST_SEEDS) or [0]
    for seed in seeds:
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**53:
            raise OptionError("seeds are whole numbers from 0 on")
    return {
        "seeds": seeds,
        "steps": number(body, "steps", 1, 200),
        "guidance": number(body, "guidance", 0, 20),
        "candidates": number(body, "candidates", 1, 16, 3),
        "anyway": bool(body.get("anyway")),
        "without": [str(word) for word in things(body, "without", 10)],
        "pins": _pins(body),
    }


def _pins(body: dict[str, Any]) -> list[dict[str, Any]]:
    pins = []
    for pin in things(body, "pins", 100):
        if not isinstance(pin, dict):
            raise OptionError("a pin has a part, a time and a position")
        place = [number({"x": value}, "x", -1e4, 1e4) for value in things(pin, "position", 3)]
        if len(place) != 3 or None in place:
            raise OptionError("the position of a pin is three numbers")
        turn = pin.get("rotation")
        if turn is not None:
            rows = [row for row in things(pin, "rotation", 3) if isinstance(row, list)]
            if [len(row) for row in rows] != [3, 3, 3]:
                raise OptionError("the rotation of a pin is a matrix of three rows")
            turn = [[number({"x": value}, "x", -1, 1, 0) for value in row] for row in rows]
        pins.append(
            {
                "part": text(pin, "part", 40),
                "time": number(pin, "time", 0, 120, 0),
                "position": place,
                "rotation": turn,
                "hold": number(pin, "hold", 0, 120, 0),
            }
        )
    return pins


def path_of(body: dict[str, Any]) -> list[list[float]] | None:
    """Points of a path on the floor, x and z [m], or None where there is none.

    Raises:
        OptionError: They are none.
    """
    points = things(body, "path", 200)
    found = []
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            raise OptionError("a path is a list of points, each with x and z")
        found.append([number({"x": value}, "x", -500, 500) for value in point])
    return found or None
