"""Where a run's batches come from: drawn one by one, a little ahead, or from a pool that processes fill."""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch

from bunraku.diffusion.examples.attended import ExampleBank, take_of
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.diffusion.trainer import Example, Trainer
from bunraku_lab.training.rows.clip_rows import ClipSet, MotionBatch
from bunraku_lab.training.rows.row_pool import FedPool, RowPool
from bunraku_lab.training.rows.row_workers import RowMaker, RowWorkers
from bunraku_lab.training.rows.text_bank import TextBank

__all__ = ["BatchSource", "BatchesAhead", "PooledBatches", "Sources"]


@dataclass(frozen=True)
class Sources:
    """What rows get beside their motions: sentences encoded, and examples where the network attends to them."""

    text: TextBank
    examples: ExampleBank | None = None

    def __call__(self, batch: MotionBatch) -> tuple[TextBatch, RetrievedExamples | None]:
        text = self.text(batch.sentences)
        if self.examples is None:
            return text, None
        found = self.examples(text.arrays(), [{take_of(name) for name in own} for own in batch.clips])
        return text, RetrievedExamples(*map(torch.from_numpy, (found.values, found.lengths, found.pooled)))


class BatchSource(Protocol):
    """What a run learns from."""

    def next(self) -> Example:
        """The batch of the trainer's step."""
        ...

    def close(self) -> None:
        """End what makes batches."""
        ...


class BatchesAhead:
    """Batches from the trainer's step on, made ahead by a thread: a pure function of the seed. Of P processes, number i
    takes batch P * step + i.

    Args:
        trainer: Adds noise.
        clips: What is drawn from.
        sources: What rows get beside their motions.
    """

    def __init__(self, trainer: Trainer, clips: ClipSet, sources: Sources):
        self.trainer, self.clips, self.sources = trainer, clips, sources
        self._ready: queue.Queue[Any] = queue.Queue(maxsize=3)
        self._ended = threading.Event()
        self._first = trainer.step
        self._thread = threading.Thread(target=self._work, name="batches", daemon=True)
        self._thread.start()

    def _put(self, item: object) -> None:
        while not self._ended.is_set():
            try:
                return self._ready.put(item, timeout=0.2)
            except queue.Full:
                continue

    def _work(self) -> None:
        processes, config = self.trainer.processes, self.trainer.config
        number = processes.count * self._first + processes.index
        try:
            while not self._ended.is_set():
                batch = self.clips.batch(config.seed, number, config.batch, config.compose)
                self._put((number, batch, *self.sources(batch)))
                number += processes.count
        except Exception as error:  # handed to the training loop
            self._put(error)

    def next(self) -> Example:
        """See `BatchSource`."""
        item = self._ready.get()
        if isinstance(item, Exception):
            raise item
        number, batch, text, found = item
        return self.trainer.example(batch, text, [self.trainer.config.seed, number], examples=found)

    def close(self) -> None:
        """See `BatchSource`."""
        self._ended.set()
        self._thread.join()  # a process that ends while a thread is inside torch is aborted


class PooledBatches:
    """Batches from a pool on the trainer's device. A run that goes on fills it anew, so it does not learn from the very
    rows that it would have seen.

    Args:
        trainer: Adds noise.
        clips: What is drawn from.
        sources: What rows get beside their motions.
    """

    def __init__(self, trainer: Trainer, clips: ClipSet, sources: Sources):
        config, processes = trainer.config, trainer.processes
        self.trainer = trainer
        maker = RowMaker(
            clips, sources.text, config.seed, config.compose, trainer.mesh_bank, config.cross, sources.examples
        )
        if clips.events > 0:
            clips.event_pool()  # once for all of them
        workers = RowWorkers(maker, config.workers, processes.count * trainer.step + processes.index, processes.count)
        self._least = min(config.pool, 8 * config.batch)
        self.fed = FedPool(RowPool(config.pool, clips.frames, trainer.device, trainer.mesh_bank), workers)
        seed = np.random.SeedSequence([config.seed, trainer.step, processes.index]).generate_state(1, np.uint64)[0]
        self._random = torch.Generator(trainer.device).manual_seed(int(seed >> 1))

    def next(self) -> Example:
        """See `BatchSource`."""
        self.fed.feed(self._least)
        return self.trainer.noised(self.fed.pool.draw(self.trainer.config.batch, self._random), self._random)

    def close(self) -> None:
        """See `BatchSource`."""
        self.fed.close()
