"""What the adaptation's last layer learns from (Eq. 7 to 11 of TapMo): ARAP pseudo-labels, inputs and losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from bunraku.core.body.reference import LOOSE_ON_PEOPLE
from bunraku.core.files import remove_leftovers
from bunraku.core.motion import handle_offsets
from bunraku.generation.sampler import sampling_steps
from bunraku.language.encoders import TextEncoder
from bunraku_lab.datasets.characters.bank import CharacterBank
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.denoiser import Denoiser, add_noise, alphas_cumprod, capped_on_people
from bunraku_lab.nn.text import tensors_of
from bunraku_lab.training.losses.meshes import ARM_VERTICES, Fitted, MeshDraw, MeshLearning
from bunraku_lab.training.rows.clip_rows import ClipSet


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
    system: EdgeSystem, start: Tensor, strength: float | Tensor = 3.0, steps: int = 3, longest: float = LOOSE_ON_PEOPLE,
    calm: float = 0.0,
) -> Tensor:  # fmt: skip
    """The adaptation that keeps edges at their lengths [TapMo 10], shape (B, N, K, 3).

    Args:
        system: Edges and motions.
        start: delta-hat, what the network says now, shape (B, N, K, 3).
        strength: nu_v: how much the squared changes, in units of the extent, count beside the squared step [m^2]; one
            for all, or one for each row.
        steps: Gauss-Newton steps, each held near the one before.
        longest: Delta is cut to this length [m], so that it repairs the mesh and does not change what the motion says.
        calm: Weight of the squared length of delta, so that it stays short where edges allow it; 0 in the paper.
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


class AdaptationHead(nn.Module):
    """`adaptation_out` while it learns: its weights plus a change that is linear in whitened inputs.

    The frames of a token share most of the change.

    Args:
        weight: The layer's weights so far, shape (F * 3 K, D), for F frames a token.
        bias: Shape (F * 3 K,).
        white: Whitening of the inputs, shape (q, D).
        centre: Their mean, shape (D,).
        handles: K.
    """

    weight: Tensor
    bias: Tensor
    white: Tensor
    centre: Tensor

    def __init__(self, weight: Tensor, bias: Tensor, white: Tensor, centre: Tensor, handles: int):
        super().__init__()
        self.handles, self.patch = handles, len(weight) // (3 * handles)
        for name, value in (("weight", weight), ("bias", bias), ("white", white), ("centre", centre)):
            self.register_buffer(name, value.clone())
        self.shared = nn.Parameter(torch.zeros(3 * handles, len(white) + 1))
        self.apart = nn.Parameter(torch.zeros(self.patch, 3 * handles, len(white) + 1))

    def _change(self) -> Tensor:
        return (self.shared + 0.3 * self.apart).flatten(0, 1)

    def forward(self, seen: Tensor) -> Tensor:
        """Inputs (B, T, D) to (B, T, F, K, 3)."""
        inner = (seen - self.centre) @ self.white.T
        one = torch.ones_like(inner[..., :1])
        out = seen @ self.weight.T + self.bias + torch.cat([inner, one], -1) @ self._change().T
        return out.unflatten(-1, (self.patch, self.handles, 3))

    @torch.no_grad()
    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the plain linear layer that does the same."""
        change = self._change()
        weight = self.weight + change[:, :-1] @ self.white
        return weight, self.bias + change[:, -1] - change[:, :-1] @ (self.white @ self.centre)


def whitening(seen: Tensor, hidden: int, mesh_size: int) -> tuple[Tensor, Tensor]:
    """What makes inputs even: hidden states by their main directions, the mesh token by at most `mesh_size` of its own.

    Args:
        seen: Inputs, shape (rows, D), of which the first `hidden` are hidden states.
        hidden: Their number d.
        mesh_size: Directions of the mesh token; 0 leaves it out.

    Returns:
        Whitening (q, D) and centre (D,).
    """
    centre = seen.mean(0)
    blocks = []
    for part, most in ((slice(0, hidden), hidden), (slice(hidden, seen.shape[1]), mesh_size)):
        values = seen[:, part] - centre[part]
        if not values.shape[1] or not most:
            continue
        spread, directions = torch.linalg.eigh((values.T @ values / len(values)).double())
        order = torch.arange(len(spread)).flip(0)[:most]
        spread, directions = spread[order], directions[:, order]
        kept = spread > 1e-4 * spread[0].clamp(min=1e-12)
        # directions that hardly vary are not blown up to the size of those that do
        scale = (spread[kept] + 0.01 * spread[0]).rsqrt()
        block = torch.zeros(int(kept.sum()), seen.shape[1])
        block[:, part] = (directions[:, kept] * scale).T.float()
        blocks.append(block)
    return torch.cat(blocks), centre


def label_distance(delta: Tensor, label: Tensor) -> Tensor:
    """[TapMo 11]: squared distance of the adaptation from its pseudo-label, mean over frames and handles [cm^2].

    Args:
        delta: What the layer says [m], shape (B, N, K, 3).
        label: What Eq. 10 says [m], shape (B, N, K, 3).
    """
    return (label - delta)[:, :, 1:].square().sum(-1).mean() * 1e4


class MeshLosses:
    """nu_h L_h + nu_a L_a (Eq. 9 of TapMo) of an adaptation, and the discriminator that L_a learns against.

    Args:
        bank: The characters.
        frames: Frames of each motion that are looked at.
        spring: nu_h.
        adversarial: nu_a; 0 leaves the discriminator as it is.
    """

    def __init__(self, bank: CharacterBank, frames: int, spring: float, adversarial: float):
        self.learning = MeshLearning(bank, frames)
        self.spring, self.adversarial = spring, adversarial

    def able(self, row: Tensor) -> np.ndarray:
        """Which pairs have a character with arms, by the row of each in the bank."""
        return np.flatnonzero(self.learning.bank.arms.cpu()[row.cpu()].numpy())

    def __call__(self, features: Tensor, delta: Tensor, row: Tensor, random: np.random.Generator) -> Tensor:
        """What L_m + nu_h L_h + nu_a L_a [TapMo 9] has beside L_m, which the denoiser has learned by before, a scalar;
        the discriminator learns where it has its turn (A.2).

        Args:
            features: Motions (B, N, 271), not in network units.
            delta: Their adaptation [m], shape (B, N, K, 3).
            row: The character of each, shape (B,).
            random: Draws the frames and the vertices of the arms.
        """
        learning, device, count = self.learning, delta.device, len(row)
        frames = min(learning.frames, delta.shape[1])
        starts = torch.from_numpy(random.integers(delta.shape[1] - frames + 1, size=count)).to(device)
        picked = random.integers(learning.bank.arm_points.shape[1], size=(count, ARM_VERTICES))
        draw = MeshDraw(row, starts, frames, torch.from_numpy(picked).to(device))
        learns = self.adversarial > 0 and learning.learns
        spring, adversarial, real, fake = learning.losses(draw, features, delta, learns)
        if self.adversarial > 0:
            _, learning.score = learning.learn(real, fake, learns)
        return self.spring * spring + self.adversarial * adversarial


CHUNK = 32
KIND = "adaptation-pairs"


@dataclass(frozen=True, eq=False)
class AdaptationPairs:
    """P motions on characters, N frames each, in T tokens.

    Args:
        seen: What the linear layer sees: hidden state and mesh token, shape (P, T, 2 d), float16.
        motion: The denoised motion in network units, shape (P, N, 271), float16.
        row: The character of each in the bank, shape (P,).
    """

    seen: Tensor
    motion: Tensor
    row: Tensor


@dataclass(frozen=True)
class PairPlan:
    """What is drawn.

    Args:
        count: How many pairs.
        frames: Frames of each, a multiple of the model's frames a token.
        digest: What they depend on; chunks of another are made again.
        seed: Of the draws.
    """

    count: int
    frames: int
    digest: str
    seed: int = 0


@torch.no_grad()
def collect_pairs(
    model: Denoiser, encoder: TextEncoder, clips: ClipSet, bank: CharacterBank, rows: np.ndarray, folder: Path,
    plan: PairPlan, progress: Callable[[int, int], None] | None = None,
) -> AdaptationPairs:  # fmt: skip
    """Draw pairs of a training clip and a character; chunks that an earlier call wrote are read, not made again.

    Args:
        model: The denoiser.
        encoder: Its text encoder.
        clips: Clips in the model's units.
        bank: Characters.
        rows: Those that may be drawn; people's clips go to all of them, a creature's own to itself.
        folder: Where the chunks are kept.
        plan: How many are drawn.
        progress: Called with (done, total).
    """
    count, frames = plan.count, plan.frames
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    curve, names = alphas_cumprod(), {name: row for row, name in enumerate(bank.names)}
    device = model.mean.device
    parts: list[dict[str, Tensor]] = []
    for chunk, start in enumerate(range(0, count, CHUNK)):
        size, path = min(CHUNK, count - start), folder / f"pairs_{chunk:04d}.safetensors"
        if path.is_file():
            state, config = load_checkpoint(path, KIND)
            if config == {"digest": plan.digest, "size": size}:
                parts.append({"seen": state["seen"].half(), "motion": state["motion"].half(), "row": state["row"]})
                continue
        random = np.random.default_rng([plan.seed, chunk, 3])
        values, sentences, chosen = np.zeros((size, frames, model.config.features), np.float32), [], []
        index = 0
        while index < size:
            drawn = clips.draw(random)
            if len(drawn.values) < frames:
                continue
            begin = int(random.integers(len(drawn.values) - frames + 1))
            values[index] = drawn.values[begin : begin + frames]
            own = names.get(drawn.mesh) if drawn.mesh is not None else None
            chosen.append(own if own is not None and own in rows else int(rows[int(random.integers(len(rows)))]))
            sentences.append(drawn.sentence)
            index += 1
        step = torch.tensor([sampling_steps(int(random.integers(10, 31)))[-1] for _ in range(size)], device=device)
        clean = torch.from_numpy(values).to(device)
        noise = torch.from_numpy(random.standard_normal(values.shape, np.float32)).to(device)
        text, yes = tensors_of(encoder.encode(sentences)).to(device), torch.ones(size, dtype=torch.bool, device=device)
        row = torch.tensor(chosen)
        condition = model.condition(text.tokens, text.mask, text.pooled, bank.features[row].to(device), yes, yes)
        mesh = cast(Any, condition.mesh).tensor
        hidden = model.hidden(
            add_noise(clean, noise, step, curve), step, torch.full((size,), frames, device=device), condition
        )
        motion = model.get_submodule("motion_out")(hidden).reshape(size, -1, model.config.features)[:, :frames]
        seen = torch.cat([hidden, mesh[:, None].expand(-1, hidden.shape[1], -1)], dim=-1)
        part = {"seen": seen.half().cpu(), "motion": motion.half().cpu(), "row": row}
        save_checkpoint(path, part, {"digest": plan.digest, "size": size}, KIND)
        parts.append(part)
        if progress is not None:
            progress(start + size, count)
    return AdaptationPairs(*(torch.cat([part[name] for part in parts]) for name in ("seen", "motion", "row")))
