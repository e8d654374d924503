"""The Adversarial Loss L_a (Eq. 8 of TapMo): the arms of a handle-driven mesh should move as those of a skeleton-driven
one.

100 vertices of the arms are drawn for each character, because that is where motions distort most (section 3.2). Real
samples are those vertices under the character's own rig, fakes are the same under its handles; both turn by the same
rotations.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.body.layout import HANDLE_NAMES
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.training.losses.batched_fit import Fitted, bone_positions, move_points, posed_positions

__all__ = [
    "ARM_VERTICES", "MARGIN", "MeshMotionDiscriminator", "adversarial_loss", "discriminator_loss", "discriminator_turn",
    "handle_driven",
    "skeleton_driven",
]  # fmt: skip

ARM_VERTICES = 100
MARGIN = 0.3
_CHEST = HANDLE_NAMES.index("spine3")


class MeshMotionDiscriminator(nn.Module):
    """Disc of Eq. 8: a score for the motion of arm vertices.

    Each vertex of a frame goes through one small network with its rest position beside its displacement; maximum and
    mean over the vertices give the frame, since they are drawn in any order; two convolutions over time and the mean
    give the score.
    """

    def __init__(self, width: int = 64):
        super().__init__()
        self.vertex = nn.Sequential(nn.Linear(6, width), nn.LeakyReLU(0.2), nn.Linear(width, width), nn.LeakyReLU(0.2))
        self.time = nn.Sequential(
            nn.Conv1d(2 * width, width, 3, padding=1),
            nn.LeakyReLU(0.2),
            nn.Conv1d(width, width, 3, padding=1),
            nn.LeakyReLU(0.2),
        )
        self.score = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        """Logits, shape (B,), of arm motions (B, N, P, 6) as `handle_driven` gives them; the sigmoid of one is
        Disc(V).
        """
        h = self.vertex(points)
        h = torch.cat([h.amax(2), h.mean(2)], dim=-1).transpose(1, 2)
        return self.score(self.time(h).mean(2)).squeeze(-1)


def discriminator_loss(real: Tensor, fake: Tensor) -> Tensor:
    """What the discriminator minimises: -(E[log Disc(real)] + E[log(1 - Disc(fake))]) of Eq. 8, from logits of shape
    (B,).
    """
    return F.softplus(-real).mean() + F.softplus(fake).mean()


def adversarial_loss(fake: Tensor) -> Tensor:
    """Adversarial Loss L_a [TapMo 8], the part that the denoiser minimises: E[log(1 - Disc(fake))], from logits of
    shape (B,).
    """
    return -F.softplus(fake).mean()


def discriminator_turn(score: float, margin: float = MARGIN) -> bool:
    """Whose turn it is (A.2): the discriminator learns only while the mean score of fakes exceeds the margin, the
    denoiser else.
    """
    return score > margin


def _seen_from_chest(
    points: Tensor, rest: Tensor, turn: Tensor, position: Tensor, anchor: Tensor, extent: Tensor
) -> Tensor:
    """Rest place and displacement as the chest sees them, over the character's extent, shape (B, N, P, 6).

    Args:
        points: Posed vertices, shape (B, N, P, 3).
        rest: Their rest positions, shape (B, P, 3).
        turn: Rotation of the chest, shape (B, N, 3, 3).
        position: Where the chest's handle is taken to, shape (B, N, 3).
        anchor: Its rest position, shape (B, 3).
        extent: Shape (B,).
    """
    seen = (points - position[:, :, None]) @ turn
    own = (rest - anchor[:, None])[:, None].expand_as(seen)
    return torch.cat([own, seen - own], dim=-1) / extent[:, None, None, None]


def handle_driven(fitted: Fitted, bank: CharacterBank, picked: Tensor, delta: Tensor | None = None) -> Tensor:
    """V^g of Eq. 8: arm vertices moved by the handles, with the adaptation, as the discriminator sees them, shape (B,
    N, P, 6).

    Args:
        fitted: The motions on B characters.
        bank: The characters.
        picked: Arm vertices of the bank's, shape (B, P).
        delta: Adaptation [m of the reference body], shape (B, N, K, 3).
    """
    row = fitted.row
    translations, positions = posed_positions(fitted, bank, delta)
    rest, index, weights = (
        _take(values[row], picked) for values in (bank.arm_points, bank.arm_index, bank.arm_weights)
    )
    points = move_points(rest, index, weights, fitted.rotations, bank.handles[row], translations)
    return _seen_from_chest(
        points,
        rest,
        fitted.rotations[:, :, _CHEST],
        positions[:, :, _CHEST],
        bank.handles[row, _CHEST],
        bank.extent[row],
    )


@torch.no_grad()
def skeleton_driven(fitted: Fitted, bank: CharacterBank, picked: Tensor) -> Tensor:
    """V^sk of Eq. 8: the same vertices moved by the character's own rig under the same rotations, shape (B, N, P,
    6).
    """
    row = fitted.row
    each = torch.arange(len(row), device=row.device)
    rotations, positions = bone_positions(fitted, bank)
    rest, index, weights = (
        _take(values[row], picked) for values in (bank.arm_points, bank.arm_bones, bank.arm_bone_weights)
    )
    joints, chest, anchor = bank.bone_joints[row], bank.chest_bone[row], bank.handles[row, _CHEST]
    points = move_points(rest, index, weights, rotations, joints, positions - joints[:, None])
    turn = rotations[each, :, chest]
    position = torch.einsum("bnij,bj->bni", turn, anchor - joints[each, chest]) + positions[each, :, chest]
    return _seen_from_chest(points, rest, turn, position, anchor, bank.extent[row])


def _take(values: Tensor, picked: Tensor) -> Tensor:
    """values[b, picked[b]], shapes (B, A, C) and (B, P) -> (B, P, C)."""
    return values.gather(1, picked[..., None].expand(-1, -1, values.shape[2]))
