"""A run that trains one network on one processor, beside the running mean of its weights."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from bunraku.errors import OptionError
from bunraku.nn.checkpoints import TrainingState, save_training_state
from bunraku_lab.training.runs.runs import careful_step, follow_weights, learning_rate, resumed

__all__ = ["AveragedRun", "share_done"]

Network = TypeVar("Network", bound=torch.nn.Module)


def share_done(seconds: float, minutes: float, step: int, steps: int) -> float:
    """How far a run is through its minutes, or through its steps where `minutes` is 0; 0 to 1."""
    return min(seconds / (60 * minutes) if minutes > 0 else step / max(steps, 1), 1.0)


class AveragedRun(Generic[Network]):
    """A network, the running mean of its weights, which is what is validated and saved, and its optimiser.

    Args:
        out: Folder of the run.
        model: The network.
        average: Another of the same shape, which takes the weights of the first.
        optimizer: Of the first.
    """

    def __init__(self, out: Path, model: Network, average: Network, optimizer: torch.optim.Optimizer):
        self.out, self.model, self.average, self.optimizer = Path(out), model, average.eval(), optimizer
        self.average.load_state_dict(self.model.state_dict())
        self.step, self.seconds = 0, 0.0

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Count the processor time of a block."""
        start = time.process_time()
        yield
        self.seconds += time.process_time() - start

    def set_rate(self, peak: float, warmup: int, done: float, least: float = 0.02) -> float:
        """Set the learning rate of the next step (`nn.runs.learning_rate`) and give it back."""
        rate = learning_rate(peak, self.step, warmup, done, least)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        return rate

    def update(self, decay: float) -> None:
        """Step along the gradients, forget them, and move the running mean, quickly in the first steps."""
        careful_step(self.model, self.optimizer)
        self.optimizer.zero_grad(set_to_none=True)
        self.step += 1
        follow_weights(self.average, self.model, min(decay, self.step / (self.step + 10)))

    def save_state(
        self, settings: dict[str, Any], values: dict[str, Any], generators: dict[str, torch.Tensor] | None = None
    ) -> None:
        """Write all that is needed to go on; a kill leaves the last state."""
        models = {"model": self.model.state_dict(), "average": self.average.state_dict()}
        optimizers, values = {"adam": self.optimizer.state_dict()}, {"seconds": self.seconds, **values}
        state = TrainingState(self.step, models, optimizers, settings, values, generators or {})
        save_training_state(self.out / "state.safetensors", state)

    def restore_state(self) -> TrainingState | None:
        """Go on from the folder's state; None where there is none yet.

        Raises:
            OptionError: The run was started with another network.
            WeightsError: The state is damaged.
        """
        try:
            state = resumed(self.out, self.model, self.average, self.optimizer)
        except (RuntimeError, ValueError) as error:
            advice = "give the same settings, or another folder"
            raise OptionError(f"{self.out}: this run was started with another network; {advice}") from error
        if state is not None:
            self.step, self.seconds = state.step, float(state.values["seconds"])
        return state
