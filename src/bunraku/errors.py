"""The errors that Bunraku raises on purpose: each is one sentence that names the thing and says what to do."""

from __future__ import annotations

import errno
import os
from pathlib import Path

__all__ = [
    "BunrakuError", "CharacterError", "FULL_DISK", "FormatError", "MissingExtraError", "MotionError",
    "NotUnderstood", "OptionError", "WeightsError", "is_fault", "sentence_of",
]  # fmt: skip


class BunrakuError(Exception):
    """Base of all errors that a user can fix; the command line prints it without a traceback and exits with 2."""


class FormatError(BunrakuError):
    """A file cannot be read or written.

    Args:
        path: The file at fault.
        problem: What is wrong, and what to do about it, as the rest of a sentence.
    """

    def __init__(self, path: str | Path, problem: str):
        super().__init__(f"{path}: {problem}")
        self.path = Path(path)


class CharacterError(BunrakuError):
    """A mesh, a rig or its handles break the rules of a character."""


class MotionError(BunrakuError):
    """A motion breaks the rules of its kind."""


class OptionError(BunrakuError):
    """An option or a prompt is outside what Bunraku can do."""


class NotUnderstood(OptionError):
    """No movement of a sentence is understood; `force` goes on nevertheless, which each door says in its own words."""


class WeightsError(BunrakuError):
    """A checkpoint is missing, broken or of another kind."""


class MissingExtraError(BunrakuError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str, purpose: str):
        super().__init__(f"{purpose} needs {package}; install it with: pip install 'bunraku[{extra}]'")


FULL_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Numbers of system errors that say that a disk, a quota or a file is full."""
_FAULT = "this is a fault of Bunraku, not yours"
_NO_MEMORY = ("not enough memory", "can't allocate memory", "out of memory")
"""What torch says in a RuntimeError when the memory of the processor or of a graphics card is full."""


def sentence_of(
    error: Exception, elsewhere: str = "write to another folder", debug: str = "run again with --debug"
) -> str:
    """One sentence for any exception.

    Args:
        error: What was raised.
        elsewhere: What else can be done where the disk is full.
        debug: How to see the traceback of a fault.
    """
    if isinstance(error, BunrakuError):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and error.name == "torch":
        return str(MissingExtraError("PyTorch", "lab", "what trains, measures and builds data"))
    no_memory = isinstance(error, RuntimeError) and any(words in str(error) for words in _NO_MEMORY)
    if no_memory or isinstance(error, MemoryError):
        return "the memory is not enough for this; close other programs, or give a smaller mesh or fewer seconds"
    if isinstance(error, OSError):
        where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
        if error.errno in FULL_DISK:
            return f"{where}the disk is full; free some space or {elsewhere}"
        if isinstance(error, PermissionError):
            return f"{where}permission denied; choose a file or folder that you may use"
        if error.errno == errno.ENAMETOOLONG:
            return f"{where}the name is too long for this disk; choose a shorter one"
        return f"{where}{error.strerror or error}"
    return f"{_FAULT}: {type(error).__name__}: {error}; {debug} and report what it prints"


def is_fault(error: Exception) -> bool:
    """Whether an exception is a fault of Bunraku itself, which no user can fix."""
    return not isinstance(error, BunrakuError) and sentence_of(error).startswith(_FAULT)
