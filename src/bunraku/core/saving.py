"""How `.save()` of the types finds the writers, which stand above them: one hook, which the package's face sets."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

__all__ = ["save", "set_writer"]

_writers: list[str] = []


def set_writer(writer: str) -> None:
    """Say who writes what the types hold.

    Args:
        writer: As "module:function", called with the thing, the path and the format's options; it gives the path of
            what it wrote.
    """
    _writers[:] = [writer]


def save(thing: object, path: str | Path, **options: object) -> Path:
    """Write a motion or an animation in the format that the file's suffix names and return the path.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
    """
    module, _, name = _writers[0].partition(":")
    written: Path = getattr(import_module(module), name)(thing, path, **options)
    return written
