"""The fitting of a motion to characters in torch, batched: what losses on the adaptation delta need of `fit_motion`.

Rigid motion changes no distance, so everything here is local, in the root's frame: a handle k of a character goes from
h_k to `h_k + t_k`, and a vertex as `core.skinning` says, without the global part. The translations t_k are those that
hold the joints, plus the residual of the motion and delta, both in the reference body's metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bunraku.core.skinning import handle_offsets
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.nn.residuals import capped_on_people

__all__ = ["Fitted", "bone_positions", "fit_locals", "posed_positions", "move_points"]


@dataclass(frozen=True)
class Fitted:
    """A motion on B characters, N frames each, without the adaptation.

    Args:
        row: Character of the bank, shape (B,).
        rotations: Local rotations on the character, shape (B, N, K, 3, 3).
        stiff: Local translations that hold the joints [m], shape (B, N, K, 3).
        residual: What the motion's own translations add, by the part that is played [m of the reference body], shape
            (B, N, K, 3).
    """

    row: Tensor
    rotations: Tensor
    stiff: Tensor
    residual: Tensor


def _pick(values: Tensor, index: Tensor) -> Tensor:
    """values[b, :, index[b]] for values (B, N, K, ...), shape (B, N, ...)."""
    return values[torch.arange(len(index), device=values.device), :, index]


def _attached(rotations: Tensor, bank: CharacterBank, row: Tensor) -> tuple[Tensor, Tensor]:
    """`bunraku.anatomy.joints.attached` for a batch: rotations and translations in which every joint holds."""
    rotations = rotations.clone()
    translations = rotations.new_zeros(*rotations.shape[:3], 3)
    h, joints, parents, order, present = (
        bank.handles[row],
        bank.joints[row],
        bank.parents[row],
        bank.order[row],
        bank.present[row],
    )
    each = torch.arange(len(row), device=row.device)
    for index in range(1, order.shape[1]):
        handle = order[:, index]
        parent = parents[each, handle]
        above = _pick(rotations, parent)
        own = torch.where(present[each, handle][:, None, None, None], _pick(rotations, handle), above)
        rotations[each, :, handle] = own
        joint, h_own, h_above = (joints[each, handle], h[each, handle], h[each, parent])
        moved = torch.einsum("bnij,bj->bni", above, joint - h_above) + h_above[:, None] + _pick(translations, parent)
        translations[each, :, handle] = moved - torch.einsum("bnij,bj->bni", own, joint - h_own) - h_own[:, None]
    return rotations, translations


@torch.no_grad()
def fit_locals(rotations: Tensor, translations: Tensor, bank: CharacterBank, row: Tensor) -> Fitted:
    """Motions of the reference body on characters of the bank, all stages of `fit_motion` that move handles locally.

    Args:
        rotations: Local rotations of the reference body's handles, shape (B, N, K, 3, 3).
        translations: Their local translations [m], shape (B, N, K, 3).
        bank: The characters; its row 0 is the reference body.
        row: Character of each motion, shape (B,).
    """
    residual = translations - _attached(rotations, bank, torch.zeros_like(row))[1]
    played = bank.roles[row]
    turned = rotations.gather(2, played[:, None, :, None, None].expand_as(rotations)) @ bank.rotations[row][:, None]
    own, stiff = _attached(turned, bank, row)
    return Fitted(row, own, stiff, residual)


def posed_positions(fitted: Fitted, bank: CharacterBank, delta: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Local translations t and positions h + t of the handles [m], shape (B, N, K, 3) each.

    Args:
        fitted: The motions.
        bank: The characters.
        delta: Adaptation of each part [m of the reference body], shape (B, N, K, 3); the root's does not count. None
            for none.
    """
    row = fitted.row
    total = fitted.residual if delta is None else fitted.residual + delta
    moving = torch.ones(total.shape[2], device=total.device)
    moving[0] = 0
    total = capped_on_people(total) * moving[:, None]
    extra = total.gather(2, bank.roles[row][:, None, :, None].expand_as(total))
    translations = fitted.stiff + extra * (bank.scale[row][:, None] * bank.present[row])[:, None, :, None]
    return translations, bank.handles[row][:, None] + translations


def move_points(
    points: Tensor, index: Tensor, weights: Tensor, rotations: Tensor, handles: Tensor, translations: Tensor
) -> Tensor:
    """Vertices blended from four handles each (Eq. 3 without its global part), shape (B, N, P, 3).

    Args:
        points: Rest positions [m], shape (B, P, 3).
        index: Handles, shape (B, P, 4).
        weights: Their weights, shape (B, P, 4).
        rotations: Shape (B, N, K, 3, 3).
        handles: Rest positions of the handles [m], shape (B, K, 3).
        translations: Shape (B, N, K, 3).
    """
    # sum_k s_k (R_k v + b_k) with b_k = h_k + t_k - R_k h_k: one matrix product a frame with the weights made dense
    offset = handle_offsets(handles[:, None], translations, rotations)
    dense = points.new_zeros(*points.shape[:2], handles.shape[1]).scatter_add_(2, index, weights)
    return _turned(dense, points, rotations) + torch.einsum("bpk,bnki->bnpi", dense, offset)


def _turned(dense: Tensor, points: Tensor, rotations: Tensor) -> Tensor:
    """sum_k s_pk R_k v_p as one product of (N*3, K*3) with (K*3, P) for each row."""
    batch, frames, handles = rotations.shape[:3]
    basis = (dense[..., None] * points[:, :, None]).reshape(batch, points.shape[1], handles * 3)
    left = rotations.permute(0, 1, 3, 2, 4).reshape(batch, frames * 3, handles * 3)
    return (left @ basis.transpose(1, 2)).reshape(batch, frames, 3, -1).transpose(2, 3)


@torch.no_grad()
def bone_positions(fitted: Fitted, bank: CharacterBank) -> tuple[Tensor, Tensor]:
    """The bones of the characters' own rigs under the same rotations: a skeleton that keeps its lengths.

    Returns:
        World rotations in the root's frame (B, N, J, 3, 3) and joint positions [m] (B, N, J, 3).
    """
    row = fitted.row
    each = torch.arange(len(row), device=row.device)
    joints, parents, handles = bank.bone_joints[row], bank.bone_parents[row], bank.bone_handles[row]
    rotations = fitted.rotations[each[:, None], :, handles].transpose(1, 2)
    positions = joints[:, None].expand(-1, rotations.shape[1], -1, -1).clone()
    for bone in range(1, joints.shape[1]):
        parent = parents[:, bone]
        above = parent.clamp(min=0)
        step = torch.einsum("bnij,bj->bni", _pick(rotations, above), joints[:, bone] - joints[each, above]) + _pick(
            positions, above
        )
        positions[:, :, bone] = torch.where((parent >= 0)[:, None, None], step, positions[:, :, bone])
    return rotations, positions
