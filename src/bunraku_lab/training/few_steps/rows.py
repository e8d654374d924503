"""Where a distillation's rows come from: drawn one batch after the other, or from a pool that processes fill."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch

from bunraku_lab.training.rows.drawn_rows import DrawnRows
from bunraku_lab.training.rows.row_pool import FedPool, RowPool
from bunraku_lab.training.rows.row_workers import MadeRows, RowMaker, RowWorkers

__all__ = ["PooledRows", "RowSource", "RowsInTurn"]


class RowSource(Protocol):
    """Rows with the examples that who animates finds."""

    def __call__(self, number: int) -> DrawnRows:
        """Batch of that number."""
        ...

    def close(self) -> None:
        """End what makes rows."""
        ...


class RowsInTurn:
    """Rows made when they are asked for: a pure function of the maker's seed.

    Args:
        maker: Makes them.
        rows: Of a batch.
        frames: Longest row.
        device: Where they are wanted.
    """

    def __init__(self, maker: RowMaker, rows: int, frames: int, device: torch.device):
        self.maker, self.pool = maker, RowPool(rows, frames, device, maker.meshes)

    def __call__(self, number: int) -> DrawnRows:
        """See `RowSource`."""
        return self.of(self.maker(number, self.pool.size))

    def of(self, made: MadeRows) -> DrawnRows:
        """Made rows on the device, padded to the longest."""
        self.pool.added = 0
        self.pool.add(made)
        rows = self.pool.rows(torch.arange(len(self.pool), device=self.pool.device), nearest=True)
        return replace(rows, clean=rows.clean[:, : int(rows.lengths.max())])

    def close(self) -> None:
        """See `RowSource`."""


class PooledRows:
    """Rows from a pool on the device; a run that goes on fills it anew.

    Args:
        maker: Makes them.
        workers: Processes that do.
        rows: Of a batch.
        pool: Rows that are kept.
        frames: Longest row.
        device: Where they are wanted.
    """

    def __init__(self, maker: RowMaker, workers: int, rows: int, pool: int, frames: int, device: torch.device):
        self.size, self.seed = rows, maker.seed
        self.fed = FedPool(RowPool(pool, frames, device, maker.meshes), RowWorkers(maker, workers))

    def __call__(self, number: int) -> DrawnRows:
        """See `RowSource`."""
        self.fed.feed(self.size)
        random = torch.Generator(self.fed.pool.device).manual_seed(self.seed * 1_000_003 + number)
        return self.fed.pool.draw(self.size, random, nearest=True)

    def close(self) -> None:
        """See `RowSource`."""
        self.fed.close()
