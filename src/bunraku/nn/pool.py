"""Processes that share work: none outlives the one that started them, and an interrupt ends them at once.

A worker has one thread: sums of several come in another order, and processes would only get into each other's way. It
never sees Ctrl-C, which a terminal sends to all; the process that started it ends it. Where that one is killed, Linux
kills the workers too, and elsewhere they watch a pipe that only it holds open.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

__all__ = ["THREADS", "Pool", "one_thread_each"]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that say how many threads libraries take; they read them when they are loaded."""
_PR_SET_PDEATHSIG = 1
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


class Pool:
    """Worker processes, started as they are needed.

    As a context it waits for all work at its end, but ends the workers where it is left by an error or an interrupt;
    what they had not finished is lost, what had not begun never begins.

    Args:
        jobs: How many processes at most.
        start: Called in each worker before its work.
        args: What with.
    """

    def __init__(self, jobs: int, start: Callable[..., object] | None = None, args: tuple[Any, ...] = ()):
        # Pickled apart: it may load much, and a worker is to be tied to its parent before.
        begin = pickle.dumps((start, args))
        self._pool = ProcessPoolExecutor(
            jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(), begin)
        )

    def submit(self, work: Callable[_Given, _Result], *args: _Given.args, **kwargs: _Given.kwargs) -> Future[_Result]:
        """Have a function of a module called by a worker."""
        with one_thread_each(), _interrupts_held():  # a worker that is started now inherits both
            return self._pool.submit(work, *args, **kwargs)

    def kill(self) -> None:
        """End all workers now, and forget what waits."""
        with _interrupts_held():
            for worker in list((self._pool._processes or {}).values()):
                with suppress(OSError, ValueError):  # it has ended by itself
                    worker.kill()
            self._pool.shutdown(cancel_futures=True)  # its own thread ends, which else may trip over closed pipes

    def close(self) -> None:
        """Wait for all work, then end the workers."""
        self._pool.shutdown()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            try:
                self.close()
            except BaseException:
                self.kill()
                raise
        else:
            self.kill()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes that are started within have libraries of one thread."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ |= dict.fromkeys(THREADS, "1")
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C waits, and processes that are started within never see it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(parent: int, begin: bytes) -> None:
    """Tie this worker to its parent, then do what it is to begin with."""
    tied = False
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            tied = ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0
    if os.getppid() != parent:  # it was killed before that
        os._exit(1)
    if not tied:
        threading.Thread(target=_watch, daemon=True).start()
    start, args = pickle.loads(begin)
    if start is not None:
        start(*args)


def _watch() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
