"""The process that does the work: it holds the networks and the latest characters in memory, and runs one task at a
time.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from multiprocessing.connection import Connection
from typing import Any

__all__ = ["Cancelled", "work"]

SECONDS_APART = 0.1
"""Between two messages of progress."""


class Cancelled(Exception):
    """Somebody does not want the result any more."""


def work(folder: str, pipe: Connection, bell: Connection) -> None:
    """Run tasks until the other end of the pipe is gone.

    Args:
        folder: The studio's.
        pipe: Brings (id, task, arguments) and takes (id, what, said).
        bell: Brings the id of a task that is to stop.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends this one
    parent = os.getppid()
    from bunraku.studio.tasks.table import run_task
    from bunraku.studio.workspace.workspace import Workspace

    workspace = Workspace(folder)
    workspace.warm_up()
    pipe.send(("", "warm", {}))
    while True:
        while not pipe.poll(1.0):
            if os.getppid() != parent:
                return  # the server was killed
        try:
            name, task, arguments = pipe.recv()
        except (EOFError, OSError):
            return
        told = 0.0

        def report(stage: str, done: float, name: str = name) -> None:
            nonlocal told
            while bell.poll():
                if bell.recv() == name:
                    raise Cancelled
            now = time.monotonic()
            if now - told > SECONDS_APART:
                told = now
                pipe.send((name, "progress", {"stage": stage, "done": round(float(done), 3)}))

        def partly(said: dict[str, object], name: str = name) -> None:
            pipe.send((name, "partly", said))

        try:
            report("start", 0.0)
            said = run_task(workspace, task, arguments, report, partly)
            message: tuple[str, str, dict[str, Any]] = (name, "done", said)
        except Cancelled:
            message = (name, "cancelled", {})
        except Exception as error:
            message = (name, "failed", _explained(error))
        try:
            pipe.send(message)
        except OSError:
            return


def _explained(error: Exception) -> dict[str, Any]:
    from bunraku.studio.responses import is_full, sentence_of

    if os.environ.get("BUNRAKU_DEBUG", "") not in ("", "0"):
        import traceback

        traceback.print_exception(error, file=sys.stderr)
    return {"error": sentence_of(error), "kind": type(error).__name__, "full": is_full(error)}
