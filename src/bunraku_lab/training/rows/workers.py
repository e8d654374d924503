"""Training rows on a device: drawn ahead by processes, and used several times with other noise."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait

import numpy as np
import torch
from torch import Tensor

from bunraku.generation.retrieve import ExampleBank, take_of
from bunraku.language.encoders import TEXT_LENGTH
from bunraku_lab.nn.denoiser import RetrievedExamples
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.rows.banks import MeshBank, TextBank
from bunraku_lab.training.rows.clip_rows import ClipSet, MotionBatch
from bunraku_lab.training.runs.run import Ahead, forking


@dataclass(frozen=True, eq=False)
class DrawnRows:
    """Rows of a batch on one device.

    Args:
        clean: Motions in network units, zero behind their ends, shape (B, N, D).
        lengths: Real frames, shape (B,).
        text: Sentences, encoded.
        mesh: f_phi of each row's character, shape (B, 448); None without a bank.
        known: Whether it is known, shape (B,), bool.
        person: Rows that are of the reference body, shape (B,), bool.
        examples: What the network attends to; None for a network that attends to none.
    """

    clean: Tensor
    lengths: Tensor
    text: TextBatch
    mesh: Tensor | None
    known: Tensor
    person: Tensor
    examples: RetrievedExamples | None


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
        nearest: The same with those of its own clip, as `animate` finds them.
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
    """Draws rows with their conditions.

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
        """A batch with its conditions; `random` draws its meshes."""
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
            batch.values.astype(np.float16), batch.lengths, text.tokens.numpy().astype(np.float16),
            text.mask.sum(1).numpy(), text.pooled.numpy(), mesh, np.array([name is None for name in batch.meshes]),
            found, nearest, self._unsent(np.concatenate([found, nearest])),
        )  # fmt: skip

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

    Raises:
        OptionError: This system cannot fork processes.
    """

    def __init__(self, maker: RowMaker, count: int, first: int = 0):
        context = forking()
        maker.prepare()
        self._next = first
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
        self._next += 1

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
            except Exception as error:  # handed to the trainer
                made = error
            pipe.send(made)


class RowPool:
    """Rows on a device, the newest `size` of those that were added.

    Args:
        size: Rows that are kept.
        frames: Longest row.
        device: Where.
        meshes: The bank that rows' meshes are numbered in; None for the null mesh only.
    """

    def __init__(self, size: int, frames: int, device: torch.device, meshes: MeshBank | None = None):
        self.size, self.frames, self.device = size, frames, device
        self.meshes = None if meshes is None else meshes.features.to(device)
        self.added = 0
        self._arrays: dict[str, Tensor] = {}
        self._places: dict[int, int] = {}
        self._examples: Tensor | None = None
        self._example_lengths = torch.zeros(0, dtype=torch.long, device=device)
        self._example_vectors: Tensor | None = None

    def __len__(self) -> int:
        return min(self.added, self.size)

    def add(self, rows: MadeRows) -> None:
        """Keep rows, in the place of the oldest."""
        for number, (features, vector) in rows.examples.items():
            if number not in self._places:
                self._add_example(number, torch.from_numpy(features), torch.from_numpy(vector))
        count = len(rows.lengths)
        places = (torch.arange(self.added, self.added + count) % self.size).to(self.device)
        whole = {
            "values": (torch.from_numpy(rows.values), self.frames),
            "tokens": (torch.from_numpy(rows.tokens), TEXT_LENGTH),
        }
        for name, (part, longest) in whole.items():
            kept = self._kept(name, (longest, part.shape[2]), torch.float16)
            kept[places] = 0
            kept[places, : part.shape[1]] = part.to(self.device)
        for name in ("lengths", "text_lengths", "mesh"):
            self._kept(name, (), torch.long)[places] = torch.from_numpy(getattr(rows, name)).long().to(self.device)
        self._kept("person", (), torch.bool)[places] = torch.from_numpy(rows.person).to(self.device)
        pooled = torch.from_numpy(rows.pooled)
        self._kept("pooled", (pooled.shape[1],), torch.float32)[places] = pooled.to(self.device)
        for name in ("found", "nearest"):
            numbers = getattr(rows, name)
            at = torch.tensor([[self._places[int(number)] for number in row] for row in numbers], dtype=torch.long)
            self._kept(name, (numbers.shape[1],), torch.long)[places] = at.view(count, -1).to(self.device)
        self.added += count

    def _kept(self, name: str, shape: tuple[int, ...], kind: torch.dtype) -> Tensor:
        if name not in self._arrays:
            self._arrays[name] = torch.zeros((self.size, *shape), dtype=kind, device=self.device)
        return self._arrays[name]

    def _add_example(self, number: int, features: Tensor, vector: Tensor) -> None:
        place = len(self._places)
        if self._examples is None or self._example_vectors is None or place == len(self._examples):
            room = max(256, 2 * place)
            values = torch.zeros(room, self.frames, features.shape[1], dtype=torch.float16, device=self.device)
            lengths = torch.zeros(room, dtype=torch.long, device=self.device)
            vectors = torch.zeros(room, len(vector), device=self.device)
            if self._examples is not None and self._example_vectors is not None:
                values[:place], lengths[:place] = self._examples, self._example_lengths
                vectors[:place] = self._example_vectors
            self._examples, self._example_lengths, self._example_vectors = values, lengths, vectors
        self._examples[place, : len(features)] = features.to(self.device)
        self._example_lengths[place] = len(features)
        self._example_vectors[place] = vector.to(self.device)
        self._places[number] = place

    def draw(self, size: int, random: torch.Generator, nearest: bool = False) -> DrawnRows:
        """Some of the rows.

        Args:
            size: How many.
            random: Draws them, on the pool's device.
            nearest: With the examples that `animate` finds, also those of the row's own clip.
        """
        return self.rows(torch.randint(len(self), (size,), generator=random, device=self.device), nearest)

    def rows(self, rows: Tensor, nearest: bool = False) -> DrawnRows:
        """Those in some places of the pool (B,); see `draw`."""
        arrays = self._arrays
        tokens, count = arrays["tokens"][rows].float(), arrays["text_lengths"][rows]
        mask = torch.arange(TEXT_LENGTH, device=self.device) < count[:, None]
        mesh = arrays["mesh"][rows]
        found = arrays["nearest" if nearest else "found"][rows]
        examples = None
        if found.shape[1] and self._examples is not None and self._example_vectors is not None:
            examples = RetrievedExamples(
                self._examples[found].float(), self._example_lengths[found], self._example_vectors[found]
            )
        return DrawnRows(
            arrays["values"][rows].float(), arrays["lengths"][rows], TextBatch(tokens, mask, arrays["pooled"][rows]),
            None if self.meshes is None else self.meshes[mesh.clamp(min=0)], mesh >= 0, arrays["person"][rows],
            examples,
        )  # fmt: skip


class FedPool:
    """A pool that processes fill while it is drawn from."""

    def __init__(self, pool: RowPool, workers: RowWorkers):
        self.pool, self.workers = pool, workers
        self._ahead = Ahead(workers, 8)

    def feed(self, least: int = 0) -> None:
        """Take what is ready, and wait until the pool has `least` rows.

        Raises:
            Exception: What a process raised.
        """
        while len(self.pool) < min(least, self.pool.size) or self._ahead.waits:
            self.pool.add(self._ahead.take())

    def close(self) -> None:
        """End the processes."""
        self._ahead.end()
        self.workers.close()
        self._ahead.join()
