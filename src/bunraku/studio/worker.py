"""The process that does the work, task by task, and how an error reads to the page: one sentence without paths."""

from __future__ import annotations

import _thread
import errno
import os
import re
import signal
import sys
import threading
import time
from contextlib import suppress
from multiprocessing import connection
from types import FrameType
from typing import Any

from bunraku.errors import FULL_DISK, BunrakuError, sentence_of

_SHUT = {errno.EROFS, errno.EACCES}
_FULL_WORDS = tuple(os.strerror(number).lower() for number in (*FULL_DISK, *_SHUT))
_FOLDER = re.compile(r"(?<![\w.])/(?:[^\s:/]+/)+(?=[^\s:/]+)")


def is_full(error: Exception) -> bool:
    """Whether the disk takes nothing more: it is full, or can only be read."""
    if isinstance(error, BunrakuError):
        return any(word in str(error) for word in _FULL_WORDS)
    return isinstance(error, OSError) and error.errno in (*FULL_DISK, *_SHUT)


def page_sentence(error: Exception) -> str:
    """The sentence of an exception without the folders of file names."""
    text = sentence_of(error, "start the studio with another --folder", "start the studio with BUNRAKU_DEBUG=1")
    return " ".join(_FOLDER.sub("", text).split())


SECONDS_APART = 0.1
"""Between two messages of progress; chosen by eye."""


AGAIN = 0.02
"""Seconds after which a task is stopped again where it could not be; chosen by eye."""


class Cancelled(BaseException):
    """The job was cancelled."""


class Stop:
    """Stops the task that runs, wherever it is. The bell brings the ids of tasks that are to stop."""

    def __init__(self, bell: connection.Connection) -> None:
        self.running = self._asked = ""
        self._bell = bell
        signal.signal(signal.SIGINT, self._interrupted)  # Ctrl-C is for the server, which ends this process
        threading.Thread(target=self._listen, name="bell", daemon=True).start()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._asked = self._bell.recv()
                while self._asked == self.running:
                    _thread.interrupt_main()
                    time.sleep(AGAIN)

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        if not self.running or self.running != self._asked:
            return
        while frame is not None:
            if frame.f_code.co_filename.startswith(("<frozen importlib", str(connection.__file__))):
                return  # a module that is imported by half cannot be imported again, nor half a message be read
            frame = frame.f_back
        self.running = ""
        raise Cancelled


def work(folder: str, pipe: connection.Connection, bell: connection.Connection) -> None:
    """Run tasks until the other end of the pipe is gone. The pipe brings (id, task, arguments) and takes (id, what,
    said); the bell brings the id of a task that is to stop.
    """
    stop = Stop(bell)
    parent = os.getppid()
    from bunraku.studio.tasks import run_task
    from bunraku.studio.workspace import Workspace

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
        sent = 0.0

        def report(stage: str, done: float, name: str = name) -> None:
            nonlocal sent
            now = time.monotonic()
            if now - sent > SECONDS_APART:
                sent = now
                pipe.send((name, "progress", {"stage": stage, "done": round(float(done), 3)}))

        def partly(said: dict[str, object], name: str = name) -> None:
            pipe.send((name, "partly", said))

        message: tuple[str, str, dict[str, Any]]
        try:
            stop.running = name
            try:
                report("start", 0.0)
                message = (name, "done", run_task(workspace, task, arguments, report, partly))
            except Exception as error:
                message = (name, "failed", _explained(error))
            stop.running = ""
        except Cancelled:
            message = (name, "cancelled", {})
        try:
            pipe.send(message)
        except OSError:
            return


def _explained(error: Exception) -> dict[str, Any]:
    if os.environ.get("BUNRAKU_DEBUG", "") not in ("", "0"):
        import traceback

        traceback.print_exception(error, file=sys.stderr)
    return {"error": page_sentence(error), "kind": type(error).__name__, "full": is_full(error)}
