"""`python -m bunraku`, and what the command `bunraku` calls: Ctrl-C ends it with one line from its first moment."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

__all__ = ["run"]


def run() -> NoReturn:
    """Run the command line and leave with its exit status."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:  # as in the background of a shell
        signal.signal(signal.SIGINT, _leave)
    from bunraku.cli import main

    try:
        signal.signal(signal.SIGINT, before)
        status = main()
    except KeyboardInterrupt:  # in the moment before `main` looks after it, or after
        _leave(signal.SIGINT, None)
    sys.exit(status)


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"bunraku: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    run()
