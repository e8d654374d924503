"""What a task is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from bunraku.core.animation import Animation
from bunraku.errors import OptionError
from bunraku.studio.workspace.clips import Take, body_of
from bunraku.studio.workspace.workspace import Workspace

__all__ = ["Partly", "Report", "Task", "of_handles", "put_away"]

Report = Callable[[str, float], None]
Partly = Callable[[dict[str, Any]], None]


class Task(Protocol):
    """Something that the worker does."""

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        """Do it; give what its record learns."""


def of_handles(take: Take) -> Animation:
    """What moves the handles of a take.

    Raises:
        OptionError: It moves the bones of its file.
    """
    body = body_of(take)
    if not isinstance(body, Animation):
        raise OptionError("this take moves the bones of the file; make one that moves handles to change it")
    return body


def put_away(take: Take, name: str, owner: str, shop: Workspace, partly: Partly) -> None:
    """Write a take that is finished, and tell so.

    Args:
        take: The take.
        name, owner: Ids of the take and of its character.
        shop: Where it is written.
        partly: Called with what its record learns.
    """
    partly({"take": name, "state": "done", **shop.keep(take, name, owner)})
