"""How many CPU threads a small network gets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import torch
from torch import nn

__all__ = ["fitting_threads", "one_thread"]

_SMALL = 30_000_000


@contextmanager
def fitting_threads(model: nn.Module) -> Iterator[None]:
    """One thread for a model of less than 30 million weights on the CPU, torch's own number for others.

    The products of a small model are too short to share: a second thread gains a fifth where a core is free, and where
    none is, torch's threads wait for one another and a clip takes twenty times as long. One thread also always adds in
    one order.
    """
    weights = list(model.parameters())
    small = sum(value.numel() for value in weights) < _SMALL and all(value.device.type == "cpu" for value in weights)
    with one_thread() if small else nullcontext():
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch for what is too short to share (see `fitting_threads`)."""
    before = torch.get_num_threads()
    if before > 1:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if before > 1:
            torch.set_num_threads(before)
