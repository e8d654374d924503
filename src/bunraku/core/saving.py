"""How `.save()` of the types finds the writers, which stand above them: one hook, which the package's face sets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["save", "set_writer"]

_writers: list[Callable[..., Path]] = []


def set_writer(writer: Callable[..., Path]) -> None:
    """Say who writes what the types hold.

    Args:
        writer: Called with the thing, the path and the format's options; gives the path of what it wrote.
    """
    _writers[:] = [writer]


def save(thing: object, path: str | Path, **options: Any) -> Path:
    """Write a motion or an animation in the format that the file's suffix names and return the path.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
    """
    return _writers[0](thing, path, **options)
