"""The loop of every training: step, and now and then validate, save and tell."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from bunraku_lab.training.runs.events import EventLog
from bunraku_lab.training.runs.runs import Stop, append_row

__all__ = ["Progress", "Report", "TrainingRun"]

Report = Callable[[dict[str, float]], None]
"""Called with each row of the log."""
Progress = Callable[[str, float], None]
"""Called with a stage's name and the share done."""


class TrainingRun:
    """A run in its folder, which holds the state to go on from, the checkpoint and `log.csv`.

    A subclass says what a step is (`train_step`), how far the run is (`progress`), what is validated (`validate`, on
    `held_out`) and what is saved (`save`); `learn` does the rest. Its `config` is a dataclass of `RunSettings`.
    """

    stage: ClassVar[str] = "training"
    """What progress is reported of."""
    columns: ClassVar[tuple[str, ...] | None] = ("loss", "rate")
    """What the log has of the steps: means since the last row, 0 of what did not come up; None for all."""
    log_columns: tuple[str, ...] | None = None
    """The columns of the log where rows differ; None for those of the first row."""
    flush: ClassVar[bool] = False
    """Whether numbers next to nothing are taken as 0, which is faster where moments of the optimiser become such."""
    config: Any
    out: Path
    stop: Stop
    step: int
    held_out: Sequence[Any] = ()

    @property
    def checkpoint(self) -> Path:
        """What the run is for: the weights, ready to use."""
        raise NotImplementedError

    @property
    def ticks(self) -> int:
        """What `validate_every` counts."""
        return self.step

    @property
    def ended(self) -> bool:
        """Whether this sitting is over: the run is done, or was asked to stop."""
        return self.progress() >= 1 or self.stop.asked

    @property
    def save_every(self) -> float:
        """Minutes between saved states; 0 saves at each validation, and the end of a sitting is one."""
        return 0.0

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        raise NotImplementedError

    def train_step(self) -> dict[str, float]:
        """One step; its figures."""
        raise NotImplementedError

    def validate(self) -> dict[str, float]:
        """Figures of the network on what was held out."""
        raise NotImplementedError

    def save(self, results: dict[str, float]) -> Path:
        """Write the checkpoint and the training state.

        Args:
            results: Of the validation before; none between validations.
        """
        raise NotImplementedError

    def due(self) -> bool:
        """Whether it is time to validate."""
        return self.ticks % int(self.config.validate_every) == 0

    def tells(self) -> bool:
        """Whether the log gets a row of this step though nothing is validated."""
        return False

    def begun(self) -> dict[str, float]:
        """The first columns of a row of the log."""
        return {"step": self.step}

    def event_log(self) -> EventLog:
        """Where curves go."""
        return EventLog(None)

    def learn(self, report: Report | None = None, progress: Progress | None = None) -> Path:
        """Go on to the end of the run, or until it is asked to stop.

        Args:
            report: Called with each row.
            progress: Called with a stage's name and the share done.

        Returns:
            The checkpoint.
        """
        rows: list[dict[str, float]] = []
        saved = time.monotonic()
        torch.set_flush_denormal(self.flush)
        try:
            with self.stop.listening(), self.event_log() as events:
                while not self.ended:
                    rows.append(self.train_step())
                    if progress is not None:
                        progress(self.stage, self.progress())
                    due = self.due() or (self.ended and not self.save_every)
                    results = self.validate() if due and self.held_out else {}
                    if self.save_every and time.monotonic() - saved > 60 * self.save_every:
                        self.save(results)
                        saved = time.monotonic()
                    elif due and not self.save_every:
                        self.save(results)
                    if due or self.tells():
                        line = {**self.begun(), **self._means(rows), **results}
                        rows = []
                        append_row(self.out / "log.csv", line, self.log_columns)
                        events.write(self.step, {name: line[name] for name in line if name not in ("step", "seconds")})
                        if report is not None:
                            report(line)
        finally:
            torch.set_flush_denormal(False)
        if self.save_every:
            self.save({})
        return self.checkpoint

    def _means(self, rows: list[dict[str, float]]) -> dict[str, float]:
        names = self.columns or dict.fromkeys(name for row in rows for name in row)
        return {name: float(np.mean([row[name] for row in rows if name in row] or [0.0])) for name in names}
