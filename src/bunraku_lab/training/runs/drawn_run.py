"""An averaged run whose batches are drawn by one generator, which is part of its state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bunraku_lab.training.runs.averaged_run import AveragedRun, Network, share_done
from bunraku_lab.training.runs.runs import Stop, append_row, plain_settings

__all__ = ["DrawnRun"]


class DrawnRun(AveragedRun[Network]):
    """A run of a subclass, which sets `config` and `rng` before anything is drawn.

    `config` is a dataclass with at least `minutes`, `steps` and `validate_every`; `held_out` is what is validated on.
    """

    kind: ClassVar[str]
    """Of the checkpoint, and its name."""
    columns: ClassVar[tuple[str, ...]] = ("loss", "rate")
    """What the log has of the steps: means since the last row, 0 of what did not come up."""
    config: Any
    rng: np.random.Generator
    held_out: list[Any]

    @property
    def checkpoint(self) -> Path:
        """The averaged weights."""
        return self.out / f"{self.kind}.safetensors"

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        return share_done(self.seconds, self.config.minutes, self.step, self.config.steps)

    def train_step(self) -> dict[str, float]:
        """One step; its figures."""
        raise NotImplementedError

    def validate(self) -> dict[str, float]:
        """Figures of the averaged network on what was held out."""
        raise NotImplementedError

    def write(self, note: dict[str, Any]) -> Path:
        """Write the checkpoint."""
        raise NotImplementedError

    def save(self, results: dict[str, float]) -> Path:
        """Write the checkpoint, then the training state: who is killed between goes on from the state before, and comes
        to the same checkpoint again.
        """
        settings = plain_settings(asdict(self.config))
        path = self.write({"training": settings, "seconds": self.seconds, "steps": self.step, "results": results})
        self.save_state(settings, {"rng": self.rng.bit_generator.state})
        return path

    def resume(self) -> bool:
        """Go on from the run's folder, if it holds a state; whether it did."""
        state = self.restore_state()
        if state is not None:
            self.rng.bit_generator.state = state.values["rng"]
        return state is not None

    def learn(self, report: Callable[[dict[str, float]], None] | None = None) -> Path:
        """Go on from the folder's state to the end of the run, or until it is asked to stop; each validation writes a
        row of `log.csv` and the state.

        Args:
            report: Called with each row.

        Returns:
            The checkpoint.
        """
        self.resume()
        rows: list[dict[str, float]] = []
        stop = Stop()
        with stop.listening():
            while self.progress() < 1 and not stop.asked:
                rows.append(self.train_step())
                if self.progress() < 1 and self.step % self.config.validate_every and not stop.asked:
                    continue
                means = {
                    name: float(np.mean([row[name] for row in rows if name in row] or [0.0])) for name in self.columns
                }
                results = self.validate() if self.held_out else {}
                self.save(results)
                rows = []
                line = {"step": self.step, "seconds": round(self.seconds, 1), **means, **results}
                append_row(self.out / "log.csv", line)
                if report:
                    report(line)
        return self.checkpoint
