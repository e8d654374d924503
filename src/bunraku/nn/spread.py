"""The same work for many things, on processes of this machine or on a Ray cluster, where a worker that dies costs
nothing but time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from typing import Any, TypeVar

from bunraku.errors import MissingExtraError, OptionError
from bunraku.nn.pool import THREADS, Pool

__all__ = ["MOST_JOBS", "parse_jobs", "spread"]

MOST_JOBS = 1024
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def parse_jobs(text: str) -> int | str:
    """The value of an option that says how much is done at once: a number, or "ray".

    Raises:
        OptionError: It is neither.
    """
    if text == "ray":
        return text
    if not text.isdecimal() or len(text) > 4 or not 1 <= int(text) <= MOST_JOBS:
        raise OptionError(f"--jobs is a number from 1 to {MOST_JOBS}, or ray, not {text[:40]!r}")
    return int(text)


def spread(
    work: Callable[[list[_Item]], list[_Result]],
    batches: Sequence[list[_Item]],
    jobs: int | str,
    lost: Callable[[str], _Result],
) -> Iterator[tuple[_Item, _Result]]:
    """Do all of it; give each thing with its result as it is done.

    Even one job has a process of its own with one thread: sums of several threads come in another order, and bytes
    would differ. Things whose worker died are tried once more, each by itself, so that only what is at fault fails.

    Args:
        work: A function of a module, or a `functools.partial` of one: called with a batch, it gives a result for each
            of its things. It may be called twice for the same.
        batches: What to call it with, in the order of beginning.
        jobs: How many processes, or "ray" for a cluster of the package ray, whose machines must see the same files.
        lost: Makes a result of the sentence that says why there is none.

    Raises:
        MissingExtraError: ray is not installed.
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
    """Each process has a pool of its own, so that one which is killed takes only its own batch along."""
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
