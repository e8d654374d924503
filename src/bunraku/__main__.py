"""`python -m bunraku`, and what the command `bunraku` calls: Ctrl-C ends it with one line from its first moment."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

from bunraku.interrupt import interrupt, leave, watch
from bunraku.startup import end, hurry

__all__ = ["run"]


def run() -> NoReturn:
    """Run the command line and leave with its exit status."""
    watched = watch()
    hurry(sys.argv[1:])
    from bunraku.cli import main

    try:
        if watched:
            signal.signal(signal.SIGINT, interrupt)
        status = main()
        if watched:  # all is done, and what is left is taking modules apart
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:  # in the moment before `main` looks after it, or after
        leave(signal.SIGINT, None)
    end(status)


if __name__ == "__main__":
    run()
