"""How many CPU threads a small network gets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import nn

__all__ = ["fitting_threads"]

_SMALL = 30_000_000


@contextmanager
def fitting_threads(model: nn.Module) -> Iterator[None]:
    """One thread for a model of less than 30 million weights on the CPU, torch's own number for others.

    The products of a small model are too short to share: a second thread gains a fifth where a core is free, and where none is,
    torch's threads wait for one another and a clip takes twenty times as long. One thread also always adds in one order.
    """
    before = torch.get_num_threads()
    weights = list(model.parameters())
    small = before > 1 and sum(value.numel() for value in weights) < _SMALL and all(value.device.type == "cpu" for value in weights)
    if small:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if small:
            torch.set_num_threads(before)
