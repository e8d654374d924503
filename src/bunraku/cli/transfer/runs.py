"""Many pairs of `bunraku transfer`: one after the other, on several processes, or on a Ray cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from importlib import import_module
from typing import Any

from bunraku.cli.transfer.jobs import Pair, Settings, transfer_pair
from bunraku.errors import MissingExtraError
from bunraku.nn.pool import Pool

__all__ = ["run_pairs"]


def run_pairs(pairs: list[Pair], settings: Settings, jobs: int | str) -> Iterator[tuple[Pair, str]]:
    """Do all pairs; give each with what went wrong, "" for nothing, as it is done.

    Args:
        pairs: What to do; pairs of one character follow each other.
        settings: For all.
        jobs: How many processes, or "ray" for a cluster of the package ray, whose machines must see the same files.

    Raises:
        MissingExtraError: ray is not installed.
    """
    if not pairs:
        return
    if jobs == "ray":
        yield from _on_ray(pairs, settings)
    elif jobs == 1 or len(pairs) == 1:
        for pair in pairs:
            yield pair, transfer_pair(pair, settings)
    else:
        yield from _on_processes(_batches(pairs, int(jobs)), settings, min(int(jobs), len(pairs)))


def _on_processes(batches: list[list[Pair]], settings: Settings, jobs: int) -> Iterator[tuple[Pair, str]]:
    """Each process has a pool of its own, so that one which is killed takes only its own batch along; those pairs are
    then tried alone.
    """
    waiting, alone = deque(batches), deque[list[Pair]]()
    idle: list[Pool] = []
    running: dict[Future[list[tuple[Pair, str]]], tuple[Pool, list[Pair]]] = {}
    last = False
    try:
        while waiting or running or alone:
            if not waiting and not running:
                waiting, alone, jobs, last = alone, deque(), 1, True
            while waiting and len(running) < jobs:
                batch = waiting.popleft()
                lane = idle.pop() if idle else Pool(1)
                running[lane.submit(_run_batch, batch, settings)] = lane, batch
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                lane, batch = running.pop(future)
                try:
                    done = future.result()
                    idle.append(lane)
                except Exception as error:  # the process died, for want of memory in most cases
                    lane.kill()
                    reason = (
                        f"its process ended twice ({type(error).__name__}); the memory may be too small: "
                        f"simplify the mesh or cut the motion"
                    )
                    done = [(pair, f"{pair.output.name}: {reason}") for pair in batch] if last else []
                    alone.extend([] if last else [[pair] for pair in batch])
                yield from done
    finally:
        for lane in (*idle, *(lane for lane, _ in running.values())):
            lane.kill()


def _batches(pairs: list[Pair], jobs: int) -> list[list[Pair]]:
    """Pairs of one character together, as far as that leaves enough batches for all processes; a few at once, so that
    progress is seen.
    """
    size = max(1, min(4, len(pairs) // (2 * jobs)))
    out: list[list[Pair]] = []
    for pair in pairs:
        if out and len(out[-1]) < size and out[-1][0].character == pair.character:
            out[-1].append(pair)
        else:
            out.append([pair])
    return out


def _run_batch(batch: list[Pair], settings: Settings) -> list[tuple[Pair, str]]:
    return [(pair, transfer_pair(pair, settings)) for pair in batch]


def _on_ray(pairs: list[Pair], settings: Settings) -> Iterator[tuple[Pair, str]]:
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise MissingExtraError("ray", "ray", "--jobs ray") from error
    ray.init(ignore_reinit_error=True, log_to_driver=False)
    work = ray.remote(_run_batch)
    here = [Pair(*(path.resolve() for path in (pair.character, pair.motion, pair.output))) for pair in pairs]
    own = dict(zip(here, pairs, strict=True))
    waiting = {
        work.remote(batch, settings): batch
        for batch in _batches(here, max(1, int(ray.available_resources().get("CPU", 1))))
    }
    while waiting:
        (ready,), _ = ray.wait(list(waiting), num_returns=1)
        batch = waiting.pop(ready)
        try:
            yield from ((own[pair], reason) for pair, reason in ray.get(ready))
        except ray.exceptions.RayError as error:
            if len(batch) > 1:  # each by itself: only what is at fault fails
                waiting.update({work.remote([pair], settings): [pair] for pair in batch})
            else:
                yield (
                    own[batch[0]],
                    f"{batch[0].output.name}: its task ended ({type(error).__name__}); run again with --jobs 1",
                )
