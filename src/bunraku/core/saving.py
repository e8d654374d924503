"""Functions of rooms above that the types and the files call by name, `.save()` of all types, and how animations show
themselves in a notebook.
"""

from __future__ import annotations

import base64
import html
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError

__all__ = ["Shown", "provide", "provided", "save"]

_provided: dict[str, str] = {}


def provide(**functions: str) -> None:
    """Name functions of rooms above that rooms below call, so that nothing below imports them.

    Args:
        **functions: "module:function" by the name that the rooms below use.
    """
    _provided.update(functions)


def provided(name: str) -> Callable[..., Any]:
    """The function that was provided under a name; its module is imported now."""
    module, _, function = _provided[name].partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found


def save(thing: object, path: str | Path, **options: object) -> Path:
    """Write a motion or an animation in the format that the file's suffix names and return the path.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
    """
    written: Path = provided("save")(thing, path, **options)
    return written


LARGEST_VIEW = 8 << 20
"""Bytes of a model that a notebook gets as a view; of larger ones it gets a picture."""


class Shown:
    """What shows itself in a notebook: as a view to turn, and where that would be large as a picture."""

    def sheet(self, frames: int = 8, columns: int | None = None) -> bytes:
        """A contact sheet as a PNG: pictures of moments from the first frame to the last.

        Args:
            frames: How many, 1 to 400.
            columns: How many stand in a row.
        """
        options = {} if columns is None else {"columns": columns}
        with tempfile.TemporaryDirectory() as folder:
            return save(self, Path(folder, "sheet.png"), frames=frames, **options).read_bytes()

    def _repr_html_(self) -> str:
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = save(self, Path(folder, "animation.html"), most=LARGEST_VIEW, name="animation")
                page = path.read_text(encoding="utf-8")
        except BunrakuError as error:
            picture = base64.b64encode(self.sheet()).decode()
            return f'<img alt="{html.escape(str(error))}" src="data:image/png;base64,{picture}">'
        given = html.escape(page, quote=True)
        return f'<iframe style="width:100%;height:420px;border:0" srcdoc="{given}"></iframe>'
