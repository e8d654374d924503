"""Training on several processes at once, each with its own device and its own batches, by `accelerate launch`.

One process is the rule and needs nothing; several need the package accelerate, which sets them up. All hold the same
weights and take the same steps: their gradients are averaged by one exchange of one flat array.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from bunraku.errors import MissingExtraError

__all__ = ["Processes", "open_processes"]


class Processes:
    """The processes of this run.

    Args:
        state: accelerate's `PartialState`; None for a process on its own.
    """

    def __init__(self, state: Any = None):
        self._state = state
        self.count: int = 1 if state is None else int(state.num_processes)
        self.index: int = 0 if state is None else int(state.process_index)

    @property
    def main(self) -> bool:
        """Whether this process writes files and speaks."""
        return self.index == 0

    @property
    def device(self) -> torch.device | None:
        """The device of this process; None leaves the choice to the caller."""
        return None if self._state is None else torch.device(self._state.device)

    @contextmanager
    def main_first(self) -> Iterator[None]:
        """The main process does it before the others, who then find what it wrote."""
        if self._state is None:
            yield
        else:
            with self._state.main_process_first():
                yield

    def mean(self, tensors: Sequence[Tensor], *scalars: float) -> list[float]:
        """Replace each tensor by its mean over the processes, and give the means of the numbers.

        Args:
            tensors: The same shapes in every process, of one device.
            scalars: Sent along.
        """
        if self._state is None:
            return [float(value) for value in scalars]
        from accelerate.utils import reduce

        device = self._state.device
        parts = [value.detach().reshape(-1).float() for value in tensors]
        flat = torch.cat([*parts, torch.tensor(scalars, dtype=torch.float32, device=device)])
        flat = reduce(flat, "mean")
        start = 0
        for tensor in tensors:
            tensor.copy_(flat[start : start + tensor.numel()].view_as(tensor))
            start += tensor.numel()
        return [float(value) for value in flat[start:]]

    def close(self) -> None:
        """Part from the other processes at the end of a run; all must get here."""
        if self._state is not None:
            self._state.wait_for_everyone()


def open_processes(device: str | None = None) -> Processes:
    """The processes that a launcher has started; one where none has.

    Args:
        device: What the user asked for; "cpu" keeps accelerate off the accelerators.

    Raises:
        MissingExtraError: A launcher has started several, and accelerate is not installed.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) <= 1:
        return Processes()
    try:
        from accelerate import PartialState
    except ImportError as error:
        raise MissingExtraError("accelerate", "train", "training on several processes") from error
    return Processes(PartialState(cpu=device == "cpu" or not torch.cuda.is_available()))
