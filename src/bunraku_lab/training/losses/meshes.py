"""Mesh-specific motion learning (section 3.2 of TapMo): the Spring Loss (Eq. 7) and the Adversarial Loss (Eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.geometry.rotations import matrix_from_6d
from bunraku.core.motion import handle_offsets
from bunraku.generation.features import ROOT_SIZE
from bunraku_lab.datasets.characters.bank import CharacterBank
from bunraku_lab.nn.checkpoints import TrainingState
from bunraku_lab.nn.denoiser import capped_on_people

LIMB_SPRINGS: tuple[tuple[int, int], ...] = tuple(
    spring for side in SIDES for family in FAMILIES for spring in pairwise(limb_handles(side, family))
)
"""A of Eq. 7: which handles of the limbs are adjacent."""


def springs_present(present: Tensor, roles: Tensor) -> Tensor:
    """Which springs a character has: both ends have a surface and play their own parts, shape (..., 12), bool.

    Args:
        present: Whether a handle has a surface, shape (..., K).
        roles: The part that each plays, shape (..., K).
    """
    own = present & (roles == torch.arange(roles.shape[-1], device=roles.device))
    first, second = (torch.tensor(ends, device=own.device) for ends in zip(*LIMB_SPRINGS, strict=True))
    return own[..., first] & own[..., second]


def spring_loss(positions: Tensor, rest: Tensor, springs: Tensor, sigma: float = 0.0) -> Tensor:
    """Spring Loss L_h of each row [TapMo 7], shape (B,).

    With E the distance of two adjacent handles, and frame 0 the rest pose, it is the sum over springs and frames of
    `exp(-(E_0 + sigma)) (E_n - E_0)^2 + (E_n - E_{n-1})^2`. Positions may be local: distances stay.

    Args:
        positions: Handle positions of each frame, h^1 to h^N, shape (B, N, K, 3).
        rest: Handle positions of the rest pose, h^0, shape (B, K, 3), in the same unit.
        springs: Which of `LIMB_SPRINGS` count, shape (B, 12).
        sigma: The hyper-parameter that softens all springs.
    """
    first, second = (torch.tensor(ends, device=positions.device) for ends in zip(*LIMB_SPRINGS, strict=True))
    frames = torch.cat([rest[:, None], positions], dim=1)
    distance = (frames[:, :, first] - frames[:, :, second]).square().sum(-1).add(1e-12).sqrt()
    still = distance[:, :1]
    stretch = torch.exp(-(still + sigma)) * (distance[:, 1:] - still).square()
    change = (distance[:, 1:] - distance[:, :-1]).square()
    return ((stretch + change) * springs[:, None]).sum((1, 2))


@dataclass(frozen=True)
class Fitted:
    """A motion on B characters, N frames each, without the adaptation.

    Args:
        row: Character of the bank, shape (B,).
        rotations: Local rotations on the character, shape (B, N, K, 3, 3).
        stiff: Local translations that hold the joints [m], shape (B, N, K, 3).
        residual: The motion's own translations by canonical part [m of the reference body], shape (B, N, K, 3).
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
        bank.handles[row], bank.joints[row], bank.parents[row], bank.order[row], bank.present[row],
    )  # fmt: skip
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
        delta: Adaptation of each part [m of the reference body], shape (B, N, K, 3), without the root's; or None.
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
    return _rotated_points(dense, points, rotations) + torch.einsum("bpk,bnki->bnpi", dense, offset)


def _rotated_points(dense: Tensor, points: Tensor, rotations: Tensor) -> Tensor:
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


ARM_VERTICES = 100
MARGIN = 0.3
_CHEST = HANDLE_NAMES.index("spine3")


class MeshMotionDiscriminator(nn.Module):
    """Disc of Eq. 8: a score for the motion of arm vertices.

    Each vertex of a frame goes through one small network with its rest position beside its displacement; maximum and
    mean over the vertices give the frame; two convolutions over time and the mean give the score.
    """

    def __init__(self, width: int = 64):
        super().__init__()
        self.vertex = nn.Sequential(nn.Linear(6, width), nn.LeakyReLU(0.2), nn.Linear(width, width), nn.LeakyReLU(0.2))
        self.time = nn.Sequential(
            nn.Conv1d(2 * width, width, 3, padding=1), nn.LeakyReLU(0.2), nn.Conv1d(width, width, 3, padding=1),
            nn.LeakyReLU(0.2),
        )  # fmt: skip
        self.score = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        """Logits, shape (B,), of arm motions (B, N, P, 6) of `handle_driven`; their sigmoid is Disc(V)."""
        h = self.vertex(points)
        h = torch.cat([h.amax(2), h.mean(2)], dim=-1).transpose(1, 2)
        return self.score(self.time(h).mean(2)).squeeze(-1)


def discriminator_loss(real: Tensor, fake: Tensor) -> Tensor:
    """What the discriminator minimises: -(E[log Disc(real)] + E[log(1 - Disc(fake))]) of Eq. 8, logits (B,)."""
    return F.softplus(-real).mean() + F.softplus(fake).mean()


def adversarial_loss(fake: Tensor) -> Tensor:
    """Adversarial Loss L_a [TapMo 8], which the denoiser minimises: E[log(1 - Disc(fake))], logits (B,)."""
    return -F.softplus(fake).mean()


def discriminator_learns(score: float, margin: float = MARGIN) -> bool:
    """Whether the discriminator learns (A.2): only while the mean score of fakes exceeds the margin."""
    return score > margin


def _seen_from_chest(
    points: Tensor, rest: Tensor, turn: Tensor, position: Tensor, anchor: Tensor, extent: Tensor
) -> Tensor:
    """Rest place and displacement as the chest sees them, over the character's extent, shape (B, N, P, 6)."""
    seen = (points - position[:, :, None]) @ turn
    own = (rest - anchor[:, None])[:, None].expand_as(seen)
    return torch.cat([own, seen - own], dim=-1) / extent[:, None, None, None]


def handle_driven(fitted: Fitted, bank: CharacterBank, picked: Tensor, delta: Tensor | None = None) -> Tensor:
    """V^g of Eq. 8: arm vertices moved by the handles with the adaptation, for the discriminator, (B, N, P, 6).

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
        points, rest, fitted.rotations[:, :, _CHEST], positions[:, :, _CHEST], bank.handles[row, _CHEST],
        bank.extent[row],
    )  # fmt: skip


@torch.no_grad()
def skeleton_driven(fitted: Fitted, bank: CharacterBank, picked: Tensor) -> Tensor:
    """V^sk of Eq. 8: the same vertices moved by the rig under the same rotations, shape (B, N, P, 6)."""
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


@dataclass(frozen=True, eq=False)
class MeshDraw:
    """What is looked at of motions on characters of the bank.

    Args:
        characters: Of each motion, shape (R,).
        starts: First frame of the stretch that is looked at, shape (R,).
        frames: Its length F.
        picked: Arm vertices, shape (R, 100).
    """

    characters: Tensor
    starts: Tensor
    frames: int
    picked: Tensor

    def stretch(self, values: Tensor) -> Tensor:
        """The stretch of each motion, shape (R, N, ...) -> (R, F, ...)."""
        frames = self.starts[:, None] + torch.arange(self.frames, device=self.starts.device)
        return values[torch.arange(len(frames), device=frames.device)[:, None], frames]


def local_motion(features: Tensor) -> tuple[Tensor, Tensor]:
    """Local rotations (B, N, K, 3, 3) and translations (B, N, K, 3) [m] of motion features (B, N, 271)."""
    local = features[..., ROOT_SIZE:].unflatten(-1, (HANDLE_COUNT - 1, 9)).float()
    rotations = matrix_from_6d(local[..., 3:])
    still = torch.eye(3, device=features.device).expand(*rotations.shape[:2], 1, 3, 3)
    return torch.cat([still, rotations], dim=2), torch.cat(
        [torch.zeros_like(local[:, :, :1, :3]), local[..., :3]], dim=2
    )


class MeshLearning:
    """The characters, the discriminator and its optimiser.

    Args:
        bank: The characters.
        frames: Frames of each motion that are looked at.
        learning_rate: Of the discriminator.
    """

    def __init__(self, bank: CharacterBank, frames: int, learning_rate: float = 1e-4):
        self.bank, self.frames = bank, frames
        self.discriminator = MeshMotionDiscriminator().to(bank.handles.device)
        self.optimizer = torch.optim.Adam(self.discriminator.parameters(), lr=learning_rate)
        self.score = 0.0  # the mean score of fakes, from the last step

    def losses(
        self, draw: MeshDraw, clean: Tensor, delta: Tensor, learns: bool
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Spring and adversarial loss of the adaptation, and what the discriminator is to learn from.

        Args:
            draw: The characters, and what is looked at.
            clean: Features of the motions, shape (R, N, 271).
            delta: Predicted adaptation [m], shape (R, N, K, 3).
            learns: Whether the discriminator has its turn; then the adversarial loss is 0.

        Returns:
            L_h and L_a, scalars, and real and fake samples for the discriminator, without gradients.
        """
        fitted: Fitted = fit_locals(*local_motion(draw.stretch(clean)), self.bank, draw.characters)
        offset = draw.stretch(delta).float()
        bank, row = self.bank, draw.characters
        # in the reference body's metres, so that the spring of a giant is that of a child
        scale = bank.scale[row][:, None, None]
        positions = posed_positions(fitted, bank, offset)[1] / scale[:, None]
        springs = springs_present(bank.present[row], bank.roles[row])
        spring = spring_loss(positions, bank.handles[row] / scale, springs).mean()
        fake = handle_driven(fitted, bank, draw.picked, offset)
        if learns:
            adversarial = torch.zeros((), device=delta.device)
        else:
            self.discriminator.requires_grad_(False)
            adversarial = adversarial_loss(self.discriminator(fake))
            self.discriminator.requires_grad_(True)
        return spring, adversarial, skeleton_driven(fitted, bank, draw.picked), fake.detach()

    def learn(self, real: Tensor, fake: Tensor, learns: bool) -> tuple[Tensor, float]:
        """A step of the discriminator, if it is due, on real and fake arms; its loss and the mean score of fakes."""
        with torch.set_grad_enabled(learns):
            fakes = self.discriminator(fake)
            loss = discriminator_loss(self.discriminator(real), fakes)
        if learns:
            loss.backward()
            self.optimizer.step()
            self.optimizer.zero_grad(set_to_none=True)
        return loss.detach(), float(torch.sigmoid(fakes.detach()).mean())

    def add_to(self, state: TrainingState) -> None:
        """Add the discriminator to what a run goes on from."""
        state.models["discriminator"] = self.discriminator.state_dict()
        state.optimizers["discriminator"] = self.optimizer.state_dict()
        state.values["score"] = self.score

    def restore(self, state: TrainingState) -> None:
        """Go on from a saved state; one of before there was a discriminator leaves a fresh one."""
        if "discriminator" in state.models:
            self.discriminator.load_state_dict(state.models["discriminator"])
            self.optimizer.load_state_dict(state.optimizers["discriminator"])
            self.score = float(state.values.get("score", 0.0))

    @property
    def learns(self) -> bool:
        """Whether the discriminator has its turn (A.2)."""
        return discriminator_learns(self.score, MARGIN)
