"""What a request holds, checked: JSON within bounds, a number within a range, words of a list; whole forms are read by
`studio.forms`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from bunraku.core.request.json_form import read_json
from bunraku.core.request.limits import Limit
from bunraku.errors import OptionError
from bunraku.studio.state import State

__all__ = ["beside", "body_of", "choice", "number", "ready_character", "state_of", "text"]

MOST_JSON = 4 << 20


def state_of(request: Request) -> State:
    """The state behind the routes."""
    state = request.app.state.studio if hasattr(request.app.state, "studio") else request.scope["app"].state.studio
    assert isinstance(state, State)
    return state


def ready_character(state: State, name: str) -> dict[str, Any]:
    """The record of a character that is open.

    Raises:
        OptionError: It is not.
        NotThere: There is none.
    """
    record = state.store.get("characters", name)
    if record["state"] != "ready":
        raise OptionError(f"{record['name']} is not open yet ({record['error'] or record['state']}); wait for it")
    return record


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
    found = read_json(bytes(data) or b"{}", "the request", MOST_JSON)
    if not isinstance(found, dict):
        raise OptionError("the request is no JSON object")
    return found


def beside(handler: Callable[[Request, dict[str, Any]], Any]) -> Callable[[Request], Awaitable[Any]]:
    """A route that writes to the disk: it is done beside the thread that answers, which goes on however slow the disk
    is. Such routes are done one after the other, so what one has looked up stays so until it has written.

    Args:
        handler: Called with the request and the JSON object of its body, empty where it has none.
    """

    def alone(request: Request, body: dict[str, Any]) -> Any:
        with state_of(request).writing:
            return handler(request, body)

    @functools.wraps(handler)
    async def route(request: Request) -> Any:
        body = {} if request.method in ("GET", "DELETE") else await body_of(request)
        return await run_in_threadpool(alone, request, body)

    return route


def number(body: dict[str, object], name: str, limit: Limit, default: float) -> float:
    """A number of a request, or the default where it says nothing.

    Raises:
        OptionError: It is no number, or out of range.
    """
    value = body.get(name)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise OptionError(f"{name} must be a number")
    limit.check(value, name)
    return value


def text(body: dict[str, object], name: str, most: int, default: str = "") -> str:
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


def choice(body: dict[str, object], name: str, known: Sequence[str], default: str) -> str:
    """One of some words.

    Raises:
        OptionError: It is none of them.
    """
    value = body.get(name, default)
    if value not in known:
        raise OptionError(f"{name} is one of {', '.join(known)}")
    return str(value)
