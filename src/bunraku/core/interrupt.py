"""Ctrl-C while the command line or torch is being loaded: one line, as later, and no traceback."""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # what `signal` is made of, without the enumerations that take it ten milliseconds to load
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:  # `typing` takes as long
    from types import FrameType
    from typing import NoReturn


def is_command_line() -> bool:
    """Whether Python was started to run the command line: as `bunraku` or as `python -m bunraku`."""
    program = sys.argv[0] if sys.argv else ""
    if program == "-m":  # until the module is found
        return "bunraku" in sys.orig_argv[1:4]
    return os.path.basename(program).lower() in ("bunraku", "bunraku.exe", "bunraku-script.py")


def watch_interrupts() -> bool:
    """Let Ctrl-C end the process with one line, unless the signal has another handler (or is ignored, as in the
    background).

    Returns:
        Whether it now does.
    """
    try:
        if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
            _signal.signal(_signal.SIGINT, exit_interrupted)
    except ValueError:  # not the main thread
        return False
    return _signal.getsignal(_signal.SIGINT) is exit_interrupted


def exit_interrupted(number: int, frame: FrameType | None) -> NoReturn:
    """End the process at once."""
    os.write(2, b"bunraku: interrupted\n")
    os._exit(130)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`, but exit at once while torch is being loaded: its C++ calls Python where any exception
    aborts the process. The next run of a command repairs what is half done.
    """
    if getattr(getattr(sys.modules.get("torch"), "__spec__", None), "_initializing", False):
        exit_interrupted(number, frame)
    raise KeyboardInterrupt
