"""The part network: which part of a character each point of its surface is of.

A hierarchy of points (PointNet++, Qi et al. 2017) with a transformer over the coarsest 256, so that each point knows
the whole figure. Neighbours are pooled after a linear layer of their features and positions relative to the centre,
which costs a gather and no product for each pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from bunraku.apparel.part_network import (
    BESIDE,
    CARRIERS,
    CENTRES,
    FEATURES,
    GATHERED,
    PARTS,
    POINTS,
    SCALES,
    TOKENS,
    WAVES,
    PartConfig,
)
from bunraku_lab.nn.checkpoints import SavedNetwork


class PointBatch:
    """Features and neighbours of B meshes as one block.

    Args:
        features: Shape (B, POINTS, FEATURES).
        points: Shape (B, POINTS, 3).
        pieces: Loose part of each point, from 0, shape (B, POINTS).
        tables: `gather`, `beside`, `gather_up`, `down` and `fine` of `PartPoints`, shape (B, ...), and the shares
            `down_shares` and `fine_shares`.
    """

    def __init__(self, features: np.ndarray, points: np.ndarray, pieces: np.ndarray, tables: dict[str, np.ndarray]):
        batch = len(features)
        self.features = torch.from_numpy(features.reshape(batch * POINTS, FEATURES))
        self.points = torch.from_numpy(points.astype(np.float32))
        whole = pieces.astype(np.int64) + POINTS * np.arange(batch)[:, None]
        self.piece = torch.from_numpy(np.unique(whole, return_inverse=True)[1].reshape(-1))
        below = {"gather": POINTS, "beside": CENTRES, "gather_up": CENTRES, "down": TOKENS, "fine": CENTRES}
        self.index = {
            name: torch.from_numpy(
                (tables[name].astype(np.int64) + (np.arange(batch) * size)[:, None, None]).reshape(
                    -1, tables[name].shape[2]
                )
            )
            for name, size in below.items()
        }
        self.shares = {
            name: torch.from_numpy(tables[f"{name}_shares"].astype(np.float32).reshape(-1, 3))
            for name in ("down", "fine")
        }

    def level(self, count: int) -> torch.Tensor:
        """Positions of the first points of each mesh, shape (B * count, 3)."""
        return self.points[:, :count].reshape(-1, 3)


def waves(points: torch.Tensor) -> torch.Tensor:
    """Positions as the tokens know them (`bunraku.apparel.part_network.waves`), shape (M, 3) -> (M, WAVES)."""
    turns = torch.cat([3.0 * points, 6.0 * points, 12.0 * points], 1)
    return torch.cat([2 * points, torch.sin(turns), torch.cos(turns)], 1)


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


class _Near(nn.Module):
    """The most of linear features of neighbours and of where they are from a centre."""

    def __init__(self, width: int, out: int, scale: float):
        super().__init__()
        self.value = nn.Linear(width, out)
        self.place = nn.Linear(3, out, bias=False)
        self.scale = scale

    def forward(
        self, x: torch.Tensor, points: torch.Tensor, centres: torch.Tensor, index: torch.Tensor
    ) -> torch.Tensor:
        place = self.place(self.scale * points)
        own = place if centres is points else self.place(self.scale * centres)
        return F.gelu(_Pool.apply(self.value(x) + place, index) - own)


class _Gather(nn.Module):
    """A level from the one below: each centre's own features and the most of its neighbours'."""

    def __init__(self, width: int, out: int, scale: float):
        super().__init__()
        self.near = _Near(width, out, scale)
        self.mix = nn.Linear(width + out, out)
        self.leave = nn.Linear(out, out)

    def forward(
        self,
        x: torch.Tensor,
        points: torch.Tensor,
        own: torch.Tensor,
        centres: torch.Tensor,
        index: torch.Tensor,
    ) -> torch.Tensor:
        return self.leave(F.gelu(self.mix(torch.cat([own, self.near(x, points, centres, index)], 1))))


class _Beside(nn.Module):
    """What centres see of those beside them, added to what they are."""

    def __init__(self, width: int):
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.near = _Near(width, width, SCALES[1])
        self.mix = nn.Linear(2 * width, width)
        self.leave = nn.Linear(width, width)

    def forward(self, x: torch.Tensor, points: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        own = self.norm(x)
        return x + self.leave(F.gelu(self.mix(torch.cat([own, self.near(own, points, points, index)], 1))))


class _Layer(nn.Module):
    """A transformer layer with its norms in front."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.norm_a, self.norm_b = nn.LayerNorm(width), nn.LayerNorm(width)
        self.enter, self.leave = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.wide, self.narrow = nn.Linear(width, 3 * width), nn.Linear(3 * width, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        batch, count, width = x.shape
        query, key, value = self.enter(self.norm_a(x)).view(batch, count, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(query, key, value)
        x = x + self.leave(mixed.transpose(1, 2).reshape(batch, count, width))
        return x + self.narrow(F.gelu(self.wide(self.norm_b(x))))


class PartNetwork(SavedNetwork):
    """The network.

    Args:
        config: Its shape.
    """

    kind, shape = "parts", PartConfig

    def __init__(self, config: PartConfig | None = None):
        super().__init__()
        self.config = config = config or PartConfig()
        fine, middle, coarse = config.fine, config.middle, config.coarse
        self.enter = nn.Sequential(nn.Linear(FEATURES, fine), nn.GELU(), nn.Linear(fine, fine))
        self.piece = nn.Linear(2 * fine, fine)
        self.to_centres = _Gather(fine, middle, SCALES[0])
        self.before = nn.ModuleList(_Beside(middle) for _ in range(config.before))
        self.to_tokens = _Gather(middle, coarse, SCALES[2])
        self.where = nn.Linear(WAVES, coarse)
        self.norm_tokens = nn.LayerNorm(coarse)
        self.layers = nn.ModuleList(_Layer(coarse, config.heads) for _ in range(config.layers))
        self.norm = nn.LayerNorm(coarse)
        self.down = nn.Linear(middle + coarse, middle)
        self.after = nn.ModuleList(_Beside(middle) for _ in range(config.after))
        self.last = nn.Linear(fine + middle, middle)
        self.whole = nn.Linear(2 * middle, middle)
        self.decoder = nn.Sequential(nn.LayerNorm(middle), nn.Linear(middle, len(PARTS) + 1 + len(CARRIERS)))

    def forward(self, batch: PointBatch, chosen: torch.Tensor | None = None) -> torch.Tensor:
        """Scores of the parts, of hanging, and of the carriers, shape (B * POINTS, parts + 1 + carriers).

        Args:
            batch: The meshes.
            chosen: Points that are asked for, all where None.
        """
        meshes = len(batch.points)
        all_points, centres, tokens = (batch.level(count) for count in (POINTS, CENTRES, TOKENS))
        x = self.enter(batch.features)
        x = x + F.gelu(self.piece(torch.cat([x, _PieceMean.apply(F.gelu(x), batch.piece)], 1)))
        own = x.view(meshes, POINTS, -1)[:, :CENTRES].reshape(meshes * CENTRES, -1)
        y = self.to_centres(x, all_points, own, centres, batch.index["gather"])
        for block in self.before:
            y = block(y, centres, batch.index["beside"])
        own = y.view(meshes, CENTRES, -1)[:, :TOKENS].reshape(meshes * TOKENS, -1)
        z = self.to_tokens(y, centres, own, tokens, batch.index["gather_up"]) + self.where(waves(tokens))
        z = self.norm_tokens(z).view(meshes, TOKENS, -1)
        for layer in self.layers:
            z = layer(z)
        z = _Blend.apply(self.norm(z).reshape(meshes * TOKENS, -1), batch.index["down"], batch.shares["down"])
        y = y + self.down(torch.cat([y, z], 1))
        for block in self.after:
            y = block(y, centres, batch.index["beside"])
        index, shares, piece = batch.index["fine"], batch.shares["fine"], batch.piece
        if chosen is not None:
            x, index, shares, piece = x.index_select(0, chosen), index[chosen], shares[chosen], piece[chosen]
        y = _Blend.apply(y, index, shares)
        y = F.gelu(self.last(torch.cat([x, y], 1)))
        y = y + F.gelu(self.whole(torch.cat([y, _PieceMean.apply(y, piece)], 1)))
        out: torch.Tensor = self.decoder(y)
        return out


def point_batch(
    rows: Sequence[dict[str, np.ndarray]],
    features: Sequence[np.ndarray],
    points: Sequence[np.ndarray],
    pieces: Sequence[np.ndarray],
) -> PointBatch:
    """Rows of shards as one block."""
    widths = {"beside": BESIDE, "gather": GATHERED, "gather_up": GATHERED}
    names = ("gather", "beside", "gather_up", "down", "fine", "down_shares", "fine_shares")
    tables = {name: np.stack([row[name][:, : widths.get(name, 3)] for row in rows]) for name in names}
    return PointBatch(np.stack(features), np.stack(points), np.stack(pieces), tables)
