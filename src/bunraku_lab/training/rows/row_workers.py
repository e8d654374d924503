"""Processes that draw training rows ahead, for devices that learn faster than one process draws."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait

import numpy as np

from bunraku.diffusion.examples.attended import ExampleBank, take_of
from bunraku_lab.training.rows.clip_rows import ClipSet, MotionBatch
from bunraku_lab.training.rows.mesh_bank import MeshBank
from bunraku_lab.training.rows.text_bank import TextBank
from bunraku_lab.training.runs.ahead import forking

__all__ = ["MadeRows", "RowMaker", "RowWorkers"]

ROWS = 128
"""Of one batch that a process makes."""
_AHEAD = 2


@dataclass(frozen=True, eq=False)
class MadeRows:
    """Rows as a process sends them, half as large as they are learned from.

    Args:
        values: Motions in network units, zero behind their ends, shape (B, N, D), float16.
        lengths: Real frames, shape (B,).
        tokens: Text tokens, shape (B, L, C), float16.
        text_lengths: How many of them are real, shape (B,).
        pooled: Sentence vectors, shape (B, P).
        mesh: Row of the mesh bank, -1 for the null mesh, shape (B,).
        person: Rows that are of the reference body, shape (B,).
        found: Examples, none of the row's own clip, as numbers 2 i, or 2 i + 1 for the mirror image, shape (B, R).
        nearest: The same with those of its own clip, as who animates finds them.
        examples: Features (N, D), float16, and sentence vector (P,) of examples that this process had not sent before.
    """

    values: np.ndarray
    lengths: np.ndarray
    tokens: np.ndarray
    text_lengths: np.ndarray
    pooled: np.ndarray
    mesh: np.ndarray
    person: np.ndarray
    found: np.ndarray
    nearest: np.ndarray
    examples: dict[int, tuple[np.ndarray, np.ndarray]]


@dataclass(eq=False)
class RowMaker:
    """Draws rows and all that is told of them.

    Args:
        clips: What is drawn from.
        text: Encodes sentences.
        seed: Of everything random.
        compose: Share of rows that join clips.
        meshes: f_phi of many characters; None for the null mesh only.
        cross: Share of people's rows that take any character.
        examples: What the network attends to; None for nothing.
        bucket: Neighbouring batches that share their draws, sorted by length, to pad little.
    """

    clips: ClipSet
    text: TextBank
    seed: int
    compose: float
    meshes: MeshBank | None = None
    cross: float = 0.0
    examples: ExampleBank | None = None
    bucket: int = 1
    _sent: set[int] = field(default_factory=set, init=False)

    def __call__(self, number: int, size: int = ROWS) -> MadeRows:
        """Batch `number` of the endless series of the seed."""
        batch = self.clips.batch(self.seed, number, size, self.compose, self.bucket)
        return self.made(batch, np.random.default_rng([self.seed, number, 11]))

    def prepare(self) -> None:
        """Find what is slow to find, once for all processes that make rows."""
        if self.clips.events > 0:
            self.clips.event_pool()

    def made(self, batch: MotionBatch, random: np.random.Generator) -> MadeRows:
        """A batch with all that is told of it; `random` draws its meshes."""
        text, size = self.text(batch.sentences), len(batch.lengths)
        mesh = np.full(size, -1)
        if self.meshes is not None:
            mesh = self.meshes.choose(batch.meshes, size, random, self.cross)
        found = nearest = np.zeros((size, 0), np.int64)
        if self.examples is not None:
            vectors = self.examples.vectors(text.arrays())
            own = [{take_of(name) for name in names} for names in batch.clips]
            found = np.array([_numbers(self.examples.nearest(*pair)) for pair in zip(vectors, own, strict=True)])
            nearest = np.array([_numbers(self.examples.nearest(vector)) for vector in vectors])
        return MadeRows(
            batch.values.astype(np.float16),
            batch.lengths,
            text.tokens.numpy().astype(np.float16),
            text.mask.sum(1).numpy(),
            text.pooled.numpy(),
            mesh,
            np.array([name is None for name in batch.meshes]),
            found,
            nearest,
            self._unsent(np.concatenate([found, nearest])),
        )

    def _unsent(self, numbers: np.ndarray) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        if self.examples is None:
            return {}
        new = sorted({int(number) for number in numbers.ravel()} - self._sent)
        self._sent.update(new)
        return {number: self.examples.example(number // 2, bool(number % 2)) for number in new}


def _numbers(found: list[tuple[int, bool]]) -> list[int]:
    return [2 * index + int(mirrored) for index, mirrored in found]


class RowWorkers:
    """Processes that make batches number `first`, `first` + 1, and so on; they come as they are done.

    Args:
        maker: What they make.
        count: How many.
        first: Number of the first batch.
        step: What comes between the numbers.

    Raises:
        OptionError: This system cannot fork processes.
    """

    def __init__(self, maker: RowMaker, count: int, first: int = 0, step: int = 1):
        context = forking()
        maker.prepare()
        self._next, self._by = first, step
        self._pipes: list[Connection] = []
        self._processes = []
        for _ in range(count):
            near, far = context.Pipe()
            process = context.Process(target=_make, args=(maker, far), daemon=True)
            process.start()
            far.close()
            self._pipes.append(near)
            self._processes.append(process)
        for pipe in self._pipes * _AHEAD:
            self._ask(pipe)

    def _ask(self, pipe: Connection) -> None:
        pipe.send(self._next)
        self._next += self._by

    def __iter__(self) -> Iterator[MadeRows]:
        """Batches without end.

        Raises:
            Exception: What a process raised.
        """
        while True:
            for pipe in wait(self._pipes):
                assert isinstance(pipe, Connection)
                made = pipe.recv()
                if isinstance(made, Exception):
                    raise made
                self._ask(pipe)
                yield made

    def close(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.terminate()
        for process, pipe in zip(self._processes, self._pipes, strict=True):
            process.join()
            pipe.close()


def _make(maker: RowMaker, pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that learns
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(EOFError, OSError):  # the other end is gone
        while True:
            number = pipe.recv()
            try:
                made: MadeRows | Exception = maker(number)
            except Exception as error:  # handed to who learns
                made = error
            pipe.send(made)
