"""Training on several processes: what is prepared ahead by a thread or by processes that share what is loaded, and runs
on several devices by `accelerate launch`.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from bunraku.errors import MissingExtraError, OptionError

__all__ = ["Ahead", "Processes", "forking", "open_processes"]


Item = TypeVar("Item")


def forking() -> multiprocessing.context.ForkContext:
    """How processes are started that share what this one has loaded.

    Raises:
        OptionError: This system cannot.
    """
    if "fork" not in multiprocessing.get_all_start_methods():
        raise OptionError("this system cannot fork processes; leave out --workers")
    return multiprocessing.get_context("fork")


class Ahead(Generic[Item]):
    """Items that a thread makes ahead of who takes them.

    Args:
        items: Made one by one in the thread.
        size: How many wait to be taken at the most.
    """

    def __init__(self, items: Iterable[Item], size: int):
        self._ready: queue.Queue[Any] = queue.Queue(maxsize=size)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._make, args=(items,), name="ahead", daemon=True)
        self._thread.start()

    def _make(self, items: Iterable[Item]) -> None:
        try:
            for item in items:
                if not self._put(item):
                    return
        except Exception as error:  # handed to who takes
            self._put(error)

    def _put(self, item: object) -> bool:
        """Hand an item on, unless nobody takes any more."""
        while not self._ended.is_set():
            try:
                self._ready.put(item, timeout=0.2)
                return True
            except queue.Full:
                continue
        return False

    @property
    def waits(self) -> bool:
        """Whether an item is there to be taken."""
        return not self._ready.empty()

    def take(self) -> Item:
        """The next item, once it is there.

        Raises:
            Exception: What the thread raised.
        """
        item = self._ready.get()
        if isinstance(item, Exception):
            raise item
        taken: Item = item
        return taken

    def end(self) -> None:
        """Nobody takes any more."""
        self._ended.set()

    def join(self) -> None:
        """Wait for the thread: a process that ends while one is inside torch is aborted."""
        self._thread.join()


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
