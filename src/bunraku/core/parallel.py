"""Work for many items at once, on processes of this machine or on a Ray cluster."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import get_context
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from bunraku.errors import MissingExtraError

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that set how many threads libraries use; libraries read them when they are loaded."""
_PR_SET_PDEATHSIG = 1
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


class Pool:
    """Worker processes, started as they are needed.

    As a context it waits for all work at its end. Where an error or an interrupt leaves it, it kills the workers; work
    that is unfinished is lost, and work that has not begun never begins.

    Args:
        jobs: Largest number of processes.
        start, args: A function that each worker calls before its work, and its arguments.
    """

    def __init__(self, jobs: int, start: Callable[..., object] | None = None, args: tuple[Any, ...] = ()):
        # Pickled apart: it may load much, and a worker is to be tied to its parent before.
        begin = pickle.dumps((start, args))
        self._pool = ProcessPoolExecutor(
            jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(), begin)
        )

    def submit(self, work: Callable[_Given, _Result], *args: _Given.args, **kwargs: _Given.kwargs) -> Future[_Result]:
        """Have a worker call a function of a module."""
        with one_thread_each(), _interrupts_held():  # a worker that is started now inherits both
            return self._pool.submit(work, *args, **kwargs)

    def kill(self) -> None:
        """End all workers now and forget what waits."""
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
    """Tie this worker to its parent, then start."""
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


MOST_JOBS = 1024
_Item = TypeVar("_Item")


def run_parallel(
    work: Callable[[list[_Item]], list[_Result]],
    batches: Sequence[list[_Item]],
    jobs: int | str,
    lost: Callable[[str], _Result],
) -> Iterator[tuple[_Item, _Result]]:
    """Do the work of all batches; yield each item with its result as soon as it is done.

    Even one job gets its own process with one thread: several threads add in another order, so bytes would differ.
    Items whose worker died are tried once more, each by itself, so that only the faulty ones fail. MissingExtraError if
    ray is not installed.

    Args:
        work: A function of a module, or a `functools.partial` of one, from a batch to a result for each of its items.
            It may be called twice for the same batch.
        batches: The batches in order.
        jobs: Number of processes, or "ray" for a cluster of the package ray, whose machines must see the same files.
        lost: Makes a result of the sentence that says why there is none.
    """
    if jobs == "ray":
        yield from _on_ray(work, batches, lost)
    elif batches:
        yield from _on_processes(work, batches, min(int(jobs), len(batches)), lost)


def _on_processes(
    work: Callable[[list[_Item]], list[_Result]],
    batches: Sequence[list[_Item]],
    jobs: int,
    lost: Callable[[str], _Result],
) -> Iterator[tuple[_Item, _Result]]:
    """Each process is a pool of its own, so that a killed one takes only its own batch along."""
    waiting, alone = deque(batches), deque[list[_Item]]()
    idle: list[Pool] = []
    running: dict[Future[list[_Result]], tuple[Pool, list[_Item]]] = {}
    last = False
    try:
        while waiting or running or alone:
            if not waiting and not running:
                waiting, alone, jobs, last = alone, deque(), 1, True
            while waiting and len(running) < jobs:
                batch = waiting.popleft()
                lane = idle.pop() if idle else Pool(1)
                running[lane.submit(work, batch)] = lane, batch
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                lane, batch = running.pop(future)
                try:
                    results = future.result()
                    idle.append(lane)
                except BrokenProcessPool:  # the process died, for want of memory in most cases
                    lane.kill()
                    if not last:
                        alone.extend([item] for item in batch)
                        continue
                    results = [lost("its process ended twice; the memory may be too small")] * len(batch)
                except BaseException:
                    lane.kill()
                    raise
                yield from zip(batch, results, strict=True)
    finally:
        for lane in (*idle, *(lane for lane, _ in running.values())):
            lane.kill()


def _on_ray(
    work: Callable[[list[_Item]], list[_Result]], batches: Sequence[list[_Item]], lost: Callable[[str], _Result]
) -> Iterator[tuple[_Item, _Result]]:
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "--jobs ray") from error
    ray.init(ignore_reinit_error=True, log_to_driver=False, runtime_env={"env_vars": dict.fromkeys(THREADS, "1")})
    task = ray.remote(_called).options(max_retries=2)  # also where a machine goes away
    waiting = {task.remote(work, batch): batch for batch in batches}
    while waiting:
        (ready,), _ = ray.wait(list(waiting), num_returns=1)
        batch = waiting.pop(ready)
        try:
            yield from zip(batch, ray.get(ready), strict=True)
        except ray.exceptions.RayError as error:
            if len(batch) > 1:
                waiting.update({task.remote(work, [item]): [item] for item in batch})
            else:
                yield batch[0], lost(f"its task ended ({type(error).__name__}); run the same command again")


def _called(work: Callable[[list[_Item]], list[_Result]], batch: list[_Item]) -> list[_Result]:
    return work(batch)
