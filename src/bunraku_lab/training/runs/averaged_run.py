"""A run that trains one network on one processor, beside the running mean of its weights."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Generic, TypedDict, TypeVar

import numpy as np
import torch

from bunraku.errors import OptionError
from bunraku.formats.files import sweep
from bunraku_lab.nn.checkpoints import TrainingState, load_training_state, save_training_state
from bunraku_lab.training.runs.runs import Stop, careful_step, follow_weights, learning_rate, plain_settings
from bunraku_lab.training.runs.training_run import Progress, Report, TrainingRun

__all__ = ["AveragedRun", "TrainingNote", "share_done"]


class TrainingNote(TypedDict):
    """What a checkpoint says of its training: settings, time on one core [s], and figures of the last validation."""

    training: dict[str, object]
    seconds: float
    steps: int
    results: dict[str, float]


Network = TypeVar("Network", bound=torch.nn.Module)


def share_done(seconds: float, minutes: float, step: int, steps: int) -> float:
    """How far a run is through its minutes, or through its steps where `minutes` is 0; 0 to 1."""
    return min(seconds / (60 * minutes) if minutes > 0 else step / max(steps, 1), 1.0)


class AveragedRun(TrainingRun, Generic[Network]):
    """A network, the running mean of its weights, which is what is validated and saved, and its optimiser.

    A subclass says what a step's loss is (`step_loss`), what is validated (`validate`, on `held_out`) and how the
    checkpoint is written (`write`). Its `config` is a dataclass of `TrainingSettings`. What it draws by `rng` is part
    of its state.

    Args:
        out: Folder of the run.
        model: The network.
        average: Another of the same shape, which takes the weights of the first.
        optimizer: Of the first.
    """

    kind: str
    """Of the checkpoint, and its name."""
    every_row: ClassVar[bool] = False
    """Whether the log has a row of each step, and not of validations alone."""
    least: ClassVar[float] = 0.02
    """What is left of the peak rate at the end."""
    rng: np.random.Generator

    def __init__(self, out: Path, model: Network, average: Network, optimizer: torch.optim.Optimizer):
        self.out, self.model, self.average, self.optimizer = Path(out), model, average.eval(), optimizer
        self.average.load_state_dict(self.model.state_dict())
        self.step, self.seconds, self.stop = 0, 0.0, Stop()

    def set_up(
        self,
        make: Callable[[], Network],
        prepare: Callable[[Network], None] = lambda model: None,
        betas: tuple[float, float] = (0.9, 0.999),
    ) -> None:
        """Begin as `__init__` does, with two networks from the seed of `config` and AdamW with its rates.

        Args:
            make: Makes a network.
            prepare: What the network gets before its mean takes it over, such as its units.
            betas: Of AdamW.
        """
        config = self.config
        torch.manual_seed(config.seed)
        self.rng = np.random.default_rng(config.seed)
        model, average = make(), make()
        prepare(model)
        adam = torch.optim.AdamW(model.parameters(), lr=config.rate, betas=betas, weight_decay=config.weight_decay)
        AveragedRun.__init__(self, config.out, model, average, adam)

    @property
    def checkpoint(self) -> Path:
        """The averaged weights."""
        return self.out / f"{self.kind}.safetensors"

    def progress(self) -> float:
        """How far the run is through its limits, 0 to 1."""
        return share_done(self.seconds, self.config.minutes, self.step, self.config.steps)

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The loss of this step, and further figures of it."""
        raise NotImplementedError

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        raise NotImplementedError

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Count the processor time of a block."""
        start = time.process_time()
        yield
        self.seconds += time.process_time() - start

    def set_rate(self, peak: float, warmup: int, done: float, least: float = 0.02) -> float:
        """Set the learning rate of the next step (`runs.learning_rate`) and give it back."""
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

    def train_step(self) -> dict[str, float]:
        """One step; its figures."""
        with self.timed():
            self.model.train()
            rate = self.set_rate(self.config.rate, self.config.warmup, self.progress(), self.least)
            loss, figures = self.step_loss()
            loss.backward()  # type: ignore[no-untyped-call]
            self.update(self.config.decay)
        return {"loss": float(loss.detach()), **figures, "rate": rate}

    def extras(self) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
        """What the state has besides networks and time: values, and generators of torch."""
        return {"rng": self.rng.bit_generator.state}, {}

    def take_extras(self, state: TrainingState) -> None:
        """Go on with what `extras` said."""
        if "rng" in state.values:
            self.rng.bit_generator.state = state.values["rng"]

    def save_state(
        self, settings: dict[str, object], values: dict[str, object], generators: dict[str, torch.Tensor] | None = None
    ) -> None:
        """Write all that is needed to go on; a kill leaves the last state."""
        models = {"model": self.model.state_dict(), "average": self.average.state_dict()}
        optimizers, values = {"adam": self.optimizer.state_dict()}, {"seconds": self.seconds, **values}
        state = TrainingState(self.step, models, optimizers, settings, values, generators or {})
        save_training_state(self.out / "state.safetensors", state)

    def restore_state(self) -> TrainingState | None:
        """Go on from the folder's state; None where there is none yet. What a killed run left half-written goes.

        Raises:
            OptionError: The run was started with another network.
            WeightsError: The state is damaged.
        """
        sweep(self.out)
        path = self.out / "state.safetensors"
        if not path.is_file():
            return None
        state = load_training_state(path)
        try:
            self.model.load_state_dict(state.models["model"])
            self.average.load_state_dict(state.models["average"])
            self.optimizer.load_state_dict(state.optimizers["adam"])
        except (RuntimeError, ValueError) as error:
            advice = "give the same settings, or another folder"
            raise OptionError(f"{self.out}: this run was started with another network; {advice}") from error
        self.step, self.seconds = state.step, float(state.values["seconds"])
        return state

    def save(self, results: dict[str, float]) -> Path:
        """Write the checkpoint, then the training state: who is killed between goes on from the state before, and comes
        to the same checkpoint again.
        """
        settings = plain_settings(asdict(self.config))
        path = self.write({"training": settings, "seconds": self.seconds, "steps": self.step, "results": results})
        self.save_state(settings, *self.extras())
        return path

    def resume(self) -> bool:
        """Go on from the run's folder, if it holds a state; whether it did."""
        state = self.restore_state()
        if state is not None:
            self.take_extras(state)
        return state is not None

    def tells(self) -> bool:
        """Whether the log gets a row of each step."""
        return self.every_row

    def begun(self) -> dict[str, float]:
        """The first columns of a row of the log."""
        return {"step": self.step, "seconds": round(self.seconds, 1)}

    def learn(self, report: Report | None = None, progress: Progress | None = None) -> Path:
        """Go on from the folder's state (`TrainingRun.learn`).

        Raises:
            OptionError: The run was started with another network.
        """
        self.resume()
        return super().learn(report, progress)
