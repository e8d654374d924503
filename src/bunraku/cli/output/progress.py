"""Progress on standard error: a bar on a terminal, elsewhere a line for each stage that took its time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["Report", "stages"]

Report = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, 0 to 1."""
SHORT = 0.5
"""Stages that are over in less [s] are not worth a line."""


@contextmanager
def stages() -> Iterator[Report]:
    """A callback `(stage, share done from 0 to 1)` that shows where a run stands; each stage gets its own line."""
    if sys.stderr.isatty():
        with _bars() as report:
            yield report
    else:
        with _lines() as report:
            yield report


@contextmanager
def _bars() -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: float) -> None:
            if stage not in tasks:
                for task in tasks.values():
                    bars.update(task, completed=1)
                tasks[stage] = bars.add_task(stage, total=1)
            bars.update(tasks[stage], completed=min(max(done, 0.0), 1.0))

        yield report


@contextmanager
def _lines() -> Iterator[Report]:
    started: dict[str, float] = {}
    finished: set[str] = set()

    def report(stage: str, done: float) -> None:
        now = time.perf_counter()
        took = now - started.setdefault(stage, now)
        if done >= 1 and stage not in finished:
            finished.add(stage)
            if took >= SHORT:
                print(f"{stage}: {took:.1f} s", file=sys.stderr)

    yield report
