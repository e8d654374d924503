"""The part network as it learns: which part of a character each point of its surface is of."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch

from bunraku.apparel import part_network
from bunraku.apparel.part_network import PartConfig
from bunraku_lab.nn.differentiable import OPERATIONS, Array, Trainable


class PointBatch:
    """Features and neighbours of B meshes as one block: all their tokens, then their other centres, then their other
    points.

    Args:
        features: Shape (B, S, FEATURES).
        points: Shape (B, S, 3).
        pieces: Loose part of each point, from 0, shape (B, S).
        tables: `gather`, `beside`, `gather_up`, `down` and `fine` of `PartPoints`, shape (B, ...), and the shares
            `down_shares` and `fine_shares`.
    """

    def __init__(self, features: np.ndarray, points: np.ndarray, pieces: np.ndarray, tables: dict[str, np.ndarray]):
        batch, count = features.shape[:2]
        number = np.arange(batch * count).reshape(batch, count)
        ends = [tables["gather_up"].shape[1], tables["gather"].shape[1]]
        cut = (part.reshape(-1) for part in np.split(number, ends, axis=1))
        mesh, point = np.divmod(np.concatenate(list(cut)), count)
        rows = np.empty((batch, count), np.int64)
        rows[mesh, point] = np.arange(batch * count)
        self.rows = torch.from_numpy(rows.reshape(-1))
        """The row of each point of each mesh."""
        self.features = torch.from_numpy(features[mesh, point])
        self.points = torch.from_numpy(points[mesh, point].astype(np.float32))
        whole = pieces.astype(np.int64) + count * np.arange(batch)[:, None]
        self.piece = torch.from_numpy(np.unique(whole[mesh, point], return_inverse=True)[1])
        self.near: dict[str, torch.Tensor] = {}
        """The tables by row."""
        for name, table in tables.items():
            used = batch * table.shape[1]
            values = table[mesh[:used], point[:used]]
            shares = name.endswith("_shares")
            self.near[name] = torch.from_numpy(
                values.astype(np.float32) if shares else rows[mesh[:used, None], values.astype(np.int64)]
            )


class _Pool(torch.autograd.Function):
    """The largest value of each channel among some rows: (N, C) and (M, K) -> (M, C)."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        # The column goes into the last four bits of each number, so that one pass finds the largest and where it was.
        marked = x.detach().contiguous().view(torch.int32) & ~15
        most = marked.index_select(0, index[:, 0])
        for column in range(1, index.shape[1]):
            other = marked.index_select(0, index[:, column]).bitwise_or_(column)
            torch.maximum(most.view(torch.float32), other.view(torch.float32), out=most.view(torch.float32))
        ctx.save_for_backward(most, index)
        ctx.count = len(x)
        return most.view(torch.float32).clone()

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:  # type: ignore[override]
        most, index = ctx.saved_tensors
        rows = index.gather(1, (most & 15).long())
        return grad.new_zeros(ctx.count, grad.shape[1]).scatter_add_(0, rows, grad), None


class _Blend(torch.autograd.Function):
    """Sums of three rows by shares: (N, C), (M, 3) and (M, 3) -> (M, C)."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, index: torch.Tensor, shares: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(index, shares)
        ctx.count = len(x)
        out = x.index_select(0, index[:, 0]) * shares[:, :1]
        for column in (1, 2):
            out.addcmul_(x.index_select(0, index[:, column]), shares[:, column : column + 1])
        return out

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None, None]:  # type: ignore[override]
        index, shares = ctx.saved_tensors
        flat = index.reshape(-1)
        order = torch.argsort(flat)
        ends = torch.zeros(ctx.count + 1, dtype=torch.int64)
        ends[1:] = torch.cumsum(torch.bincount(flat, minlength=ctx.count), 0)
        matrix = torch.sparse_csr_tensor(
            ends, order // 3, shares.reshape(-1)[order], size=(ctx.count, len(index)), check_invariants=False
        )
        return matrix @ grad, None, None


class _PieceMean(torch.autograd.Function):
    """The mean of each channel over the loose part of each row: (N, C) and (N,) -> (N, C)."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, piece: torch.Tensor) -> torch.Tensor:
        count = torch.bincount(piece)
        ends = torch.zeros(len(count) + 1, dtype=torch.int64)
        ends[1:] = torch.cumsum(count, 0)
        share = (1 / count.clamp(min=1))[piece]
        order = torch.argsort(piece)
        matrix = torch.sparse_csr_tensor(
            ends, order, share[order], size=(len(count), len(piece)), check_invariants=False
        )
        ctx.matrix, ctx.piece = matrix, piece
        return (matrix @ x).index_select(0, piece)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:  # type: ignore[override]
        return (ctx.matrix @ grad).index_select(0, ctx.piece), None


OPERATIONS.update({
    part_network.largest_of: _Pool.apply, part_network.blended: _Blend.apply, part_network.piece_mean: _PieceMean.apply,
})  # fmt: skip


class PartNetwork(Trainable):
    """`bunraku.apparel.part_network.PartNetwork` as it learns."""

    kind, shape, network = "parts", PartConfig, part_network.PartNetwork

    def forward(self, batch: PointBatch, chosen: torch.Tensor | None = None) -> torch.Tensor:
        """Scores of the parts, of hanging, and of the carriers, shape (B * S, parts + 1 + carriers).

        Args:
            batch: The meshes.
            chosen: Points that are asked for, all where None.
        """
        rows = batch.rows if chosen is None else batch.rows[chosen]
        near = SimpleNamespace(**batch.near)
        near.fine, near.fine_shares = near.fine[rows], near.fine_shares[rows]
        features, points = Array(batch.features), Array(batch.points)
        return cast(torch.Tensor, self.learning().answer(features, points, batch.piece, near, rows).tensor)


def point_batch(
    rows: Sequence[dict[str, np.ndarray]],
    features: Sequence[np.ndarray],
    points: Sequence[np.ndarray],
    pieces: Sequence[np.ndarray],
) -> PointBatch:
    """Rows of shards as one block."""
    how = PartConfig()
    widths = {"beside": how.beside, "gather": how.gathered, "gather_up": how.gathered}
    names = ("gather", "beside", "gather_up", "down", "fine", "down_shares", "fine_shares")
    tables = {name: np.stack([row[name][:, : widths.get(name, 3)] for row in rows]) for name in names}
    return PointBatch(np.stack(features), np.stack(points), np.stack(pieces), tables)
