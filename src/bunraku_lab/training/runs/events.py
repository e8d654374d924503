"""Training curves for TensorBoard."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

__all__ = ["EventLog"]


class EventLog:
    """Writes numbers to a folder that TensorBoard reads; without the package nothing is written, and one line says so.

    Args:
        folder: Where the event files go; None writes nothing and says nothing.
        say: Takes that line.
    """

    def __init__(self, folder: Path | None, say: Callable[[str], Any] = print):
        self._writer: Any = None
        if folder is None:
            return
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            say(
                "no TensorBoard curves: the package is not installed (pip install 'bunraku[train]'); log.csv has the "
                "same figures"
            )
            return
        self._writer = SummaryWriter(str(folder))  # type: ignore[no-untyped-call]

    def write(self, step: int, figures: dict[str, float]) -> None:
        """The finite ones of some figures at a step."""
        if self._writer is None:
            return
        for name, value in figures.items():
            if math.isfinite(value):
                self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def __enter__(self) -> EventLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()
