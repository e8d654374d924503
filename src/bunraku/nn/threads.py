"""How many threads a small network gets."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

    from threadpoolctl import ThreadpoolController

__all__ = ["one_thread", "side_by_side", "usable_threads"]

_spare: ContextVar[bool] = ContextVar("spare", default=False)
"""Whether `one_thread` left a processor without work."""
_One = TypeVar("_One")
_Other = TypeVar("_Other")


def usable_threads() -> int:
    """How many threads this process may take: as OMP_NUM_THREADS says, else one for each processor."""
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for each matrix product.

    The products of a small network are too short to share: a second thread gains a fifth where a core is free, and
    where none is, threads wait for one another and a clip takes many times as long. One thread also always adds in one
    order.
    """
    spare = _spare.set(usable_threads() > 1)
    try:
        if os.environ.get("OPENBLAS_NUM_THREADS") == "1":  # as on the command line
            yield
        else:
            with _libraries().limit(limits=1, user_api="blas"):
                yield
    finally:
        _spare.reset(spare)


def side_by_side(first: Callable[[], _One], second: Callable[[], _Other]) -> tuple[_One, _Other]:
    """What two calls give. Within `one_thread` the second has a thread of its own, where there is a processor for it.

    Each adds in its own order, so what comes out does not depend on whether they ran at once. They wait for each other
    once, and not in each product as the threads of a library do.
    """
    if not _spare.get():
        return first(), second()
    other = _thread().submit(second)
    try:
        one = first()
    finally:
        other.exception()  # it has ended when this goes on
    return one, other.result()


@cache
def _thread() -> ThreadPoolExecutor:
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(1, "side")


@cache
def _libraries() -> ThreadpoolController:
    """The libraries that numpy multiplies with; looking for them takes longer than to set their threads."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
