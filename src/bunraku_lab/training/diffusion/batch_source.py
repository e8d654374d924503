"""Where a run's batches come from: drawn one by one, a little ahead, or from a pool that processes fill."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

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
from bunraku_lab.training.runs.ahead import Ahead

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
        self._ahead = Ahead(self._made(trainer.step), 3)

    def _made(self, first: int) -> Iterator[tuple[int, MotionBatch, TextBatch, RetrievedExamples | None]]:
        processes, config = self.trainer.processes, self.trainer.config
        for number in itertools.count(processes.count * first + processes.index, processes.count):
            batch = self.clips.batch(config.seed, number, config.batch, config.compose)
            yield number, batch, *self.sources(batch)

    def next(self) -> Example:
        """See `BatchSource`."""
        number, batch, text, found = self._ahead.take()
        return self.trainer.example(batch, text, [self.trainer.config.seed, number], examples=found)

    def close(self) -> None:
        """See `BatchSource`."""
        self._ahead.end()
        self._ahead.join()


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
