"""Functions of rooms above that rooms below call by name, `.save()` of all types, and animations in a notebook."""

from __future__ import annotations

import base64
import html
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError

_provided: dict[str, str] = {}


def provide(**functions: str) -> None:
    """Register functions of rooms above, "module:function" by the name that rooms below use, which import none."""
    _provided.update(functions)


def provided(name: str) -> Callable[..., Any]:
    """The function of a name; its module is imported now."""
    module, _, function = _provided[name].partition(":")
    provided_function: Callable[..., Any] = getattr(import_module(module), function)
    return provided_function


class Saved:
    """What is written to files: motions and animations."""

    def save(self, path: str | Path, **options: object) -> Path:
        """Write this in the format that the file's suffix names and return the path; `bunraku.files.save` says what
        each format holds and which options it has.

        Raises:
            FormatError: The suffix is unknown, or the file cannot be written.
            OptionError: The format has no such option, or its value makes no sense.
        """
        written: Path = provided("save")(self, path, **options)
        return written

    def __repr__(self) -> str:
        motion: Any = self
        return f"<{type(self).__name__}: {len(motion)} frames, {len(motion) / motion.fps:.4g} s>"


LARGEST_VIEW = 8 << 20
"""Bytes of a model that a notebook gets as a view; of larger ones it gets a picture."""


class Shown(Saved):
    """What appears in a notebook: as a view that can be rotated, or, where that would be large, as a picture."""

    def __repr__(self) -> str:
        shown: Any = self
        name, parts = shown.character.name, len(shown.handles.positions)
        return (
            f"<{type(self).__name__} of {name!r}: {len(shown.character.vertices):,} vertices, {parts} parts, "
            f"{len(shown.motion) / shown.fps:.4g} s>"
        )

    def sheet(self, frames: int = 8, columns: int | None = None) -> bytes:
        """A contact sheet as a PNG: `frames` pictures (1 to 400) from first to last frame, `columns` in a row."""
        options = {} if columns is None else {"columns": columns}
        with tempfile.TemporaryDirectory() as folder:
            return self.save(Path(folder, "sheet.png"), frames=frames, **options).read_bytes()

    def _repr_html_(self) -> str:
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = self.save(Path(folder, "animation.html"), most=LARGEST_VIEW, name="animation")
                page = path.read_text(encoding="utf-8")
        except BunrakuError as error:
            picture = base64.b64encode(self.sheet()).decode()
            return f'<img alt="{html.escape(str(error))}" src="data:image/png;base64,{picture}">'
        given = html.escape(page, quote=True)
        return f'<iframe style="width:100%;height:420px;border:0" srcdoc="{given}"></iframe>'
