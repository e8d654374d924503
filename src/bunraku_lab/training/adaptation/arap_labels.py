"""Pseudo-labels of the adaptation: the ARAP objective of Eq. 10 of TapMo, minimised over delta.

An edge (i, j) of the mesh goes, in the root's frame, from `base_ij` to `base_ij + sum_k (s_ik - s_jk) t_k`, and t is
linear in delta, so the objective is a sum of squares of 87 unknowns a frame, each frame on its own. Eq. 10 holds every
step near the one before by `||delta' - delta||^2`; with the squares linearised that is a Gauss-Newton step with exactly
this damping.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bunraku.body.residuals import LOOSE_ON_PEOPLE
from bunraku.core.skinning import handle_offsets
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.nn.residuals import capped_on_people
from bunraku_lab.training.losses.batched_fit import Fitted

__all__ = ["EdgeSystem", "arap_labels", "edge_system"]


@dataclass(frozen=True)
class EdgeSystem:
    """Sampled edges of B characters under their motions, N frames each.

    Args:
        base: Edge vectors without any residual, over the character's extent, shape (B, N, S, 3).
        spread: What a residual of each part adds to them [1 / m of the reference body], shape (B, S, K).
        rest: Rest lengths over the extent, shape (B, S).
        share: Edges that a sampled one stands for, shape (B,).
        residual: Residual of the motion itself [m of the reference body], shape (B, N, K, 3).
    """

    base: Tensor
    spread: Tensor
    rest: Tensor
    share: Tensor
    residual: Tensor

    def lengths(self, delta: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Edge vectors (B, N, S, 3) and their lengths over the extent (B, N, S), with an adaptation (B, N, K, 3)."""
        total = capped_on_people(self.residual if delta is None else self.residual + delta)
        edges = self.base + torch.einsum("bsk,bnki->bnsi", self.spread, total)
        return edges, edges.square().sum(-1).add(1e-16).sqrt()

    def loss(self, delta: Tensor | None = None) -> Tensor:
        """Sum over all edges of the squared change of length over the extent (Eq. 12), shape (B, N); differentiable."""
        change = self.lengths(delta)[1] - self.rest[:, None]
        return change.square().sum(-1) * self.share[:, None]


@torch.no_grad()
def edge_system(fitted: Fitted, bank: CharacterBank, picked: Tensor | None = None) -> EdgeSystem:
    """The edges that the bank keeps of each character, under the fitted motions.

    Args:
        fitted: The motions.
        bank: The characters.
        picked: Which edges, shape (S,); all that the bank keeps when None.
    """
    row = fitted.row
    h, played, extent = bank.handles[row], bank.roles[row], bank.extent[row]
    some = torch.arange(bank.edge_points.shape[1], device=row.device) if picked is None else picked
    points, index, weights = (
        values[row[:, None], some] for values in (bank.edge_points, bank.edge_index, bank.edge_weights)
    )
    batch, edges, handles = len(row), len(some), h.shape[1]
    ends = points.reshape(batch, 2 * edges, 3)
    dense = ends.new_zeros(batch, 2 * edges, handles)
    dense.scatter_add_(2, index.reshape(batch, 2 * edges, 4), weights.reshape(batch, 2 * edges, 4))
    basis = (dense[..., None] * ends[:, :, None]).unflatten(1, (edges, 2))
    basis = (basis[:, :, 0] - basis[:, :, 1]).reshape(batch, edges, handles * 3)
    frames = fitted.rotations.shape[1]
    left = fitted.rotations.permute(0, 1, 3, 2, 4).reshape(batch, frames * 3, handles * 3)
    base = (left @ basis.transpose(1, 2)).reshape(batch, frames, 3, edges).transpose(2, 3)
    apart = dense.unflatten(1, (edges, 2))
    apart = apart[:, :, 0] - apart[:, :, 1]
    offset = handle_offsets(h[:, None], fitted.stiff, fitted.rotations)
    base = base + torch.einsum("bsk,bnki->bnsi", apart, offset)
    own = apart * (bank.scale[row][:, None] * bank.present[row])[:, None]
    spread = torch.zeros_like(own).scatter_add_(2, played[:, None].expand_as(own), own)
    spread[..., 0] = 0  # the root has no local translation
    rest = (points[:, :, 0] - points[:, :, 1]).square().sum(-1).sqrt()
    size, share = extent[:, None], bank.edge_share[row] * (bank.edge_points.shape[1] / edges)
    return EdgeSystem(base / size[..., None, None], spread / size[..., None], rest / size, share, fitted.residual)


@torch.no_grad()
def arap_labels(
    system: EdgeSystem,
    start: Tensor,
    strength: float | Tensor = 3.0,
    steps: int = 3,
    longest: float = LOOSE_ON_PEOPLE,
    calm: float = 0.0,
) -> Tensor:
    """The adaptation that keeps edges at their lengths [TapMo 10], shape (B, N, K, 3).

    Args:
        system: Edges and motions.
        start: delta-hat, what the network says now, shape (B, N, K, 3).
        strength: nu_v: how much the squared changes, in units of the extent, count beside the squared step [m^2]; one
            for all, or one for each row.
        steps: Gauss-Newton steps, each held near the one before.
        longest: Delta is cut to this length [m], so that it repairs the mesh and does not change what the motion says.
        calm: Weight of the squared length of delta, so that it stays short where edges do not ask for it; 0 in the
            paper.
    """
    delta = start.clone()
    count = system.spread.shape[2]
    eye = torch.eye(3 * count, device=start.device)
    for _ in range(steps):
        edges, length = system.lengths(delta)
        change = length - system.rest[:, None]
        away = edges / length[..., None]
        slope = (away[:, :, :, None] * system.spread[:, None, :, :, None]).flatten(3)  # (B, N, S, 3K)
        weight = (strength * system.share)[:, None, None, None]
        square = (slope.transpose(2, 3) @ slope) * weight + (1 + calm) * eye
        side = (slope.transpose(2, 3) @ change[..., None]) * weight + calm * delta.flatten(2)[..., None]
        delta = delta - torch.linalg.solve(square, side).reshape(delta.shape)
        delta = delta * (longest / delta.norm(dim=-1, keepdim=True).clamp(min=1e-9)).clamp(max=1)
        delta[:, :, 0] = 0
    return delta
