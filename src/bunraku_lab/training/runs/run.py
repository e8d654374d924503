"""What all training runs share: settings, learning rate, log, the loop, and the running mean of the weights."""

from __future__ import annotations

import csv
import math
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, ClassVar, Generic, TypedDict, TypeVar

import numpy as np
import torch

from bunraku.core.files import remove_leftovers
from bunraku.errors import OptionError
from bunraku_lab.nn.checkpoints import SavedNetwork, TrainingState, load_training_state, save_training_state


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings of any run.

    Args:
        out: Folder of the run: `state.safetensors` to go on from, the weights, `log.csv`; the same one goes on.
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
        minutes: Stop after this much training time on one core, over all sittings; 0 for no limit.
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
        if self.steps < 1:
            raise OptionError("steps must be 1 or more")
        super().prepare()


def bf16_is_fast(device: torch.device | str) -> bool:
    """Whether a device has bfloat16 in hardware; a processor without it is sixty times as slow in it."""
    kind = torch.device(device).type
    if kind == "cpu":
        return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
    return kind == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)


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
    """Step along gradients clipped to a norm of 1; not at all where one of them is not a number."""
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
    new = not path.is_file() or not path.stat().st_size  # a run that is killed here leaves an empty one
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(columns or row), extrasaction="ignore")
        if new:
            writer.writeheader()
        writer.writerow({name: f"{value:.6g}" for name, value in row.items()})


def logged_columns(path: Path) -> list[str]:
    """The columns that a log already has, so that a run which goes on writes no others."""
    with path.open(newline="") as file:
        return next(csv.reader(file), [])


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
        """Write the checkpoint and the training state."""
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
    checkpoint is written (`write`). Its `config` is a `TrainingSettings`; what it draws by `rng` is kept.

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
        self, make: Callable[[], Network], prepare: Callable[[Network], None] = lambda model: None,
        betas: tuple[float, float] = (0.9, 0.999),
    ) -> None:  # fmt: skip
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
        """Write the checkpoint, with matrices in half precision."""
        assert isinstance(self.average, SavedNetwork)
        return self.average.save(self.checkpoint, note, half=True)

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
        remove_leftovers(self.out)
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
        """Write the checkpoint, then the state: a run that is killed in between comes to the same checkpoint again."""
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
    """Items that a thread makes ahead of their use.

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
        except Exception as error:  # handed to the taker
            self._put(error)

    def _put(self, item: object) -> bool:
        """Hand an item on, unless `end` was called."""
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
        """Stop making items."""
        self._ended.set()

    def join(self) -> None:
        """Wait for the thread: a process that ends while one is inside torch is aborted."""
        self._thread.join()
