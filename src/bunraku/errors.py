"""The errors that Bunraku raises on purpose: each is one sentence that names the thing and says what to do."""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "BunrakuError", "CharacterError", "FormatError", "MissingExtraError", "MotionError", "OptionError",
    "WeightsError",
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


class WeightsError(BunrakuError):
    """A checkpoint is missing, broken or of another kind."""


class MissingExtraError(BunrakuError):
    """An optional dependency is not installed; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str, purpose: str):
        super().__init__(f"{purpose} needs {package}; install it with: pip install 'bunraku[{extra}]'")
