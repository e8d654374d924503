"""How many CPU threads a small network gets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from typing import TypeVar

import torch
from torch import nn

__all__ = ["fitting_threads", "one_thread", "side_by_side"]

_SMALL = 30_000_000
_spare: ContextVar[bool] = ContextVar("spare", default=False)
"""Whether `one_thread` left a thread of torch's without work."""
_One = TypeVar("_One")
_Other = TypeVar("_Other")


@contextmanager
def fitting_threads(model: nn.Module) -> Iterator[None]:
    """One thread for a model of less than 30 million weights on the CPU, torch's own number for others.

    The products of a small model are too short to share: a second thread gains a fifth where a core is free, and where
    none is, torch's threads wait for one another and a clip takes twenty times as long. One thread also always adds in
    one order.
    """
    weights = list(model.parameters())
    small = sum(map(torch.Tensor.numel, weights)) < _SMALL and {value.device.type for value in weights} <= {"cpu"}
    with one_thread() if small else nullcontext():
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch for what is too short to share (see `fitting_threads`)."""
    before = torch.get_num_threads()
    if before == 1:
        yield
        return
    torch.set_num_threads(1)
    spare = _spare.set(True)
    try:
        yield
    finally:
        _spare.reset(spare)
        torch.set_num_threads(before)


def side_by_side(first: Callable[[], _One], second: Callable[[], _Other]) -> tuple[_One, _Other]:
    """What two calls give. Within `one_thread` the second has a thread of its own, where torch had more than one.

    Each adds in its own order, so what comes out does not depend on whether they ran at once. They wait for each other
    once, and not in each product as torch's own threads do.
    """
    if not _spare.get():
        return first(), second()
    grad, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def apart() -> _Other:
        torch.set_num_threads(1)  # of this thread
        with torch.inference_mode(inference), torch.set_grad_enabled(grad):
            return second()

    other = _thread().submit(apart)
    try:
        one = first()
    finally:
        other.exception()  # it has ended when this goes on
    return one, other.result()


@cache
def _thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "side")
