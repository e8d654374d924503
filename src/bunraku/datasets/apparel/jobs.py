"""The same work for many things, on processes of this machine or of a cluster.

Even one job has a process of its own with one thread: sums of several threads come in another order, and bytes would
differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from typing import Any

from bunraku.errors import MissingExtraError
from bunraku.nn.pool import THREADS, Pool

__all__ = ["run_jobs"]


def run_jobs(work: Callable[..., str], items: Sequence[tuple[Any, ...]], jobs: int | str) -> Iterator[tuple[int, str]]:
    """Do all of it; give each item's number with what `work` returned as it is done: "" when all went well, otherwise a
    sentence.

    Args:
        work: A function of a module, called with the values of an item.
        items: What to call it with, in the order of beginning.
        jobs: How many processes, or "ray".

    Raises:
        MissingExtraError: ray is not installed.
    """
    if not items:
        return
    if jobs == "ray":
        yield from _on_ray(work, items)
        return
    yield from _on_processes(work, items, int(jobs))


def _on_processes(work: Callable[..., str], items: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[tuple[int, str]]:
    with Pool(min(jobs, len(items))) as pool:
        waiting: dict[Future[str], int] = {}
        next_item = 0
        try:
            while waiting or next_item < len(items):
                while (
                    next_item < len(items) and len(waiting) < 2 * jobs
                ):  # few at once: neighbours share a character, and a stop is quick
                    waiting[pool.submit(work, *items[next_item])] = next_item
                    next_item += 1
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    number = waiting.pop(future)
                    yield number, future.result()
        except BrokenProcessPool:
            reason = (
                "its process was ended from outside, perhaps for want of memory; run the same command again "
                "with fewer --jobs"
            )
            yield from ((number, reason) for number in [*waiting.values(), *range(next_item, len(items))])


def _on_ray(work: Callable[..., str], items: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, str]]:
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "--jobs ray") from error
    ray.init(ignore_reinit_error=True, log_to_driver=False, runtime_env={"env_vars": dict.fromkeys(THREADS, "1")})
    task = ray.remote(work).options(max_retries=2)
    waiting = {task.remote(*item): number for number, item in enumerate(items)}
    while waiting:
        (ready,), _ = ray.wait(list(waiting), num_returns=1)
        number = waiting.pop(ready)
        try:
            yield number, ray.get(ready)
        except ray.exceptions.RayError as error:
            yield number, f"its task ended ({type(error).__name__}); run the same command again"
