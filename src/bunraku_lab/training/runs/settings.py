"""The settings of every training run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch

from bunraku.errors import OptionError

__all__ = ["RunSettings", "StepSettings", "TrainingSettings"]


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings of any run.

    Args:
        out: Folder of the run: `state.safetensors` to go on from, the weights, `log.csv`. The same folder goes on with
            the same run.
        threads: CPU threads; 0 leaves torch's choice.
        batch: Examples a step.
        validate_every: Steps between validations.
        seed: Of everything random.
    """

    out: Path = Path("runs/training")
    threads: int = 1
    batch: int = 4
    validate_every: int = 250
    seed: int = 1
    least: ClassVar[dict[str, float]] = {"batch": 1, "threads": 0, "validate_every": 1}
    """What settings are at least."""

    def prepare(self) -> None:
        """Set torch's threads and make the folder.

        Raises:
            OptionError: A setting is out of range.
        """
        for name, value in self.least.items():
            if getattr(self, name) < value:
                raise OptionError(f"{name.replace('_', '-')} must be {value} or more")
        if self.threads > 0:
            torch.set_num_threads(self.threads)
        self.out.mkdir(parents=True, exist_ok=True)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(RunSettings):
    """Settings of a run that keeps the running mean of its weights.

    Args:
        minutes: Stop after this much training time on one core, over all sittings; the learning rate falls to nothing
            by then. 0 for no limit.
        rate: Peak learning rate.
        warmup: Steps until the peak.
        decay: Decay of the running mean of the weights, which is what is validated and saved.
    """

    minutes: float = 30.0
    rate: float = 2e-3
    warmup: int = 100
    decay: float = 0.995
    least: ClassVar[dict[str, float]] = {**RunSettings.least, "minutes": 0}


@dataclass(frozen=True, kw_only=True)
class StepSettings(TrainingSettings):
    """Settings of a run that counts steps and learns by AdamW.

    Args:
        steps: Stop after so many steps, where `minutes` is 0.
        weight_decay: Of AdamW.
    """

    steps: int = 2000
    weight_decay: float = 0.01

    def prepare(self) -> None:
        """See `TrainingSettings.prepare`."""
        if self.steps < 1:
            raise OptionError("steps must be 1 or more")
        super().prepare()
