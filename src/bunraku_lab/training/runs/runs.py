"""What training runs have in common: a rate, a step, settings that JSON can say, a log, and an end when asked."""

from __future__ import annotations

import csv
import math
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import torch

__all__ = [
    "Stop",
    "append_row",
    "careful_step",
    "follow_weights",
    "learning_rate",
    "logged_columns",
    "plain_settings",
]


class Stop:
    """Set by SIGTERM or Ctrl-C: finish the step, save, leave."""

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen while the block runs, in the main thread; elsewhere nothing is caught."""

        def ask(number: int, frame: FrameType | None) -> None:
            self.asked = True

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, ask) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def learning_rate(peak: float, step: int, warmup: int, share: float, least: float = 0.02) -> float:
    """The rate of a step: it climbs to its peak and then falls as half a cosine.

    Args:
        peak: The highest rate.
        step: Steps done so far.
        warmup: Steps until the peak.
        share: How far the fall is, 0 to 1.
        least: What is left of the peak at the end.
    """
    return peak * min(1.0, (step + 1) / max(warmup, 1)) * (least + (1 - least) * 0.5 * (1 + math.cos(math.pi * share)))


def careful_step(model: torch.nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Step along gradients clipped to a norm of 1; not at all where one of them is no number."""
    norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
    if bool(torch.isfinite(norm)):
        optimizer.step()


@torch.no_grad()
def follow_weights(average: torch.nn.Module, model: torch.nn.Module, decay: float) -> None:
    """Move the running mean of a network's weights towards them; `decay` is how much of it stays."""
    torch._foreach_lerp_(list(average.parameters()), list(model.parameters()), 1 - decay)


def plain_settings(value: Any) -> Any:
    """Settings (`dataclasses.asdict`) in values that JSON can say: paths as text, tuples as lists."""
    if isinstance(value, dict):
        return {key: plain_settings(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_settings(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def append_row(path: Path, row: dict[str, float], columns: Sequence[str] | None = None) -> None:
    """Add a row to a CSV log, with a head line where the file is new.

    Args:
        path: The log.
        row: Its figures by column.
        columns: The columns, of which a row may lack some or have more; those of the row when None.
    """
    new = not path.is_file() or not path.stat().st_size  # who was killed here left an empty one
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(columns or row), extrasaction="ignore")
        if new:
            writer.writeheader()
        writer.writerow({name: f"{value:.6g}" for name, value in row.items()})


def logged_columns(path: Path) -> list[str]:
    """The columns that a log already has, so that a run which goes on writes no others."""
    with path.open(newline="") as file:
        return next(csv.reader(file), [])
