"""What a training prepares ahead: by a thread, or by processes that share what is loaded."""

from __future__ import annotations

import multiprocessing
import queue
import threading
from collections.abc import Iterable
from typing import Any, Generic, TypeVar

from bunraku.errors import OptionError

__all__ = ["Ahead", "forking"]

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
