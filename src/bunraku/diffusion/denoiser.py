"""The denoiser of Shape-aware Motion Diffusion: a transformer decoder that predicts the clean motion (Eq. 2 of TapMo).

Motion tokens attend to each other and to a memory of at most 30 text tokens and one mesh token. Two linear heads give
the motion and the adaptation of local translations (section 3.2). Where the paper is silent: layers are pre-norm; the
diffusion step and the sentence's pooled vector steer every layer by scale, shift and gate (adaptive layer norm, Peebles
& Xie 2023, with one shared projection and an offset for each layer, Chen et al. 2023); time enters by rotary positions,
so a clip of any length means the same. A token holds `frames_per_token` frames, which lets the small preset train on a
CPU.
"""

from __future__ import annotations

import math
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.body.layout import HANDLE_PARENTS
from bunraku.body.residuals import capped_on_people
from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.diffusion.features import ROOT_SIZE
from bunraku.geometry.rotations import matrix_from_6d

__all__ = ["Denoiser", "joint_offsets"]


def _rotary(length: int, size: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Cosines and sines of rotary positions (Su et al. 2021), each of shape (length, size / 2)."""
    rates = 1000.0 ** (-torch.arange(0, size, 2, device=device) / size)
    angle = torch.arange(length, device=device)[:, None] * rates
    return angle.cos(), angle.sin()


def _turn(value: Tensor, rotary: tuple[Tensor, Tensor]) -> Tensor:
    first, second = value.chunk(2, dim=-1)
    cos, sin = (part.to(value.dtype) for part in rotary)
    return torch.cat([first * cos - second * sin, first * sin + second * cos], dim=-1)


def _attend(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
    """Attention, shapes (B, H, T, d/H). On a CPU torch's fused backward takes most of a training step (1.7 s against
    0.6 s for 64 clips with plain products), so training there writes the products out.
    """
    if not (torch.is_grad_enabled() and query.device.type == "cpu"):
        return F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
    if mask is not None:
        scores = scores.masked_fill(~mask, -1e4)
    return torch.softmax(scores, dim=-1, dtype=scores.dtype) @ value


class _Layer(nn.Module):
    """Self-attention, cross-attention, feed-forward; each behind an adaptive norm and a gate."""

    def __init__(self, width: int, heads: int, feedforward: int):
        super().__init__()
        self.heads = heads
        self.offset = nn.Parameter(torch.zeros(9, width))
        self.self_in, self.self_out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.cross_query, self.cross_memory, self.cross_out = (
            nn.Linear(width, width),
            nn.Linear(width, 2 * width),
            nn.Linear(width, width),
        )
        self.wide, self.narrow = nn.Linear(width, feedforward), nn.Linear(feedforward, width)

    def _split(self, value: Tensor) -> Tensor:
        return value.unflatten(-1, (self.heads, -1)).transpose(1, 2)

    def forward(
        self,
        x: Tensor,
        memory: Tensor,
        steer: Tensor,
        rotary: tuple[Tensor, Tensor],
        mask: Tensor | None,
        memory_mask: Tensor | None,
    ) -> Tensor:
        """x (B, T, d), memory (B, M, d), steer (B, 9, d), masks (B, 1, 1, T) and (B, 1, 1, M), True where real."""
        parts = (steer + self.offset).to(x.dtype).unsqueeze(2).unbind(1)

        def norm(index: int) -> Tensor:
            return F.layer_norm(x, x.shape[-1:]) * (1 + parts[index]) + parts[index + 1]

        query, key, value = (self._split(part) for part in self.self_in(norm(0)).chunk(3, dim=-1))
        mixed = _attend(_turn(query, rotary), _turn(key, rotary), value, mask)
        x = x + parts[2] * self.self_out(mixed.transpose(1, 2).flatten(2))
        key, value = (self._split(part) for part in self.cross_memory(memory).chunk(2, dim=-1))
        mixed = _attend(self._split(self.cross_query(norm(3))), key, value, memory_mask)
        x = x + parts[5] * self.cross_out(mixed.transpose(1, 2).flatten(2))
        return x + parts[8] * self.narrow(F.gelu(self.wide(norm(6))))


def joint_offsets(moves: Tensor, features: Tensor) -> Tensor:
    """The adaptation that moves joints: delta_k = delta_p + (R_p - R_k) d_k for a handle k and its parent p, shape (B,
    N, K, 3).

    It is what `attach_joints` does to the translations when the joint of k is held d_k farther off. It turns with the
    body and fades where nothing bends, so one d_k serves all poses.

    Args:
        moves: d, how far each joint is moved [m], shape (B, N, K, 3).
        features: Motion features, whose local rotations count, shape (B, N, 271).
    """
    local = features[..., ROOT_SIZE:].unflatten(-1, (moves.shape[2] - 1, 9))
    still = torch.eye(3, device=moves.device).expand(*moves.shape[:2], 1, 3, 3)
    rotations = torch.cat([still, matrix_from_6d(local[..., 3:])], dim=2)
    parents = list(HANDLE_PARENTS[1:])
    own = ((rotations[:, :, parents] - rotations[:, :, 1:]) @ moves[:, :, 1:, :, None].to(rotations.dtype)).squeeze(-1)
    offsets = [torch.zeros_like(own[:, :, 0])]
    for handle, parent in enumerate(parents, start=1):
        offsets.append(offsets[parent] + own[:, :, handle - 1])
    return torch.stack(offsets, dim=2)


class Denoiser(nn.Module):
    """Predicts x0 and the adaptation from a noisy motion, the step, a sentence and a mesh feature (Eq. 2).

    Motion enters and leaves in network units (see `FeatureStatistics`); the statistics travel with the weights as
    buffers.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: DenoiserConfig):
        super().__init__()
        self.config = config
        self.notes: dict[str, Any] = {}  # of the checkpoint it came from
        width, patch = config.width, config.frames_per_token
        self.motion_in = nn.Linear(config.features * patch, width)
        self.text_in = nn.Linear(config.text_size, width)
        self.mesh_in = nn.Linear(config.mesh_features, width)
        self.pooled_in = nn.Linear(config.pooled_size, width)
        self.null_text = nn.Parameter(drawn(torch.empty(width), 0.02))
        self.null_pooled = nn.Parameter(drawn(torch.empty(width), 0.02))
        self.null_mesh = nn.Parameter(drawn(torch.empty(width), 0.02))
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.steer = nn.Linear(width, 9 * width)
        self.layers = nn.ModuleList(_Layer(width, config.heads, config.feedforward) for _ in range(config.layers))
        self.final = nn.Linear(width, 2 * width)
        self.motion_out = nn.Linear(width, config.features * patch)
        self.adaptation_out = nn.Linear(width * (2 if config.adaptation_mesh else 1), config.handles * 3 * patch)
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        for layer in self.layers:
            for name in ("self_out", "cross_out", "narrow"):
                linear = getattr(layer, name)
                drawn(linear.weight, 0.02 / math.sqrt(2 * config.layers))
                nn.init.zeros_(linear.bias)
        with torch.no_grad():
            self.steer.weight.mul_(0.1)
            self.steer.bias.zero_()
            self.steer.bias.view(9, width)[[2, 5, 8]] = (
                1  # gates start open: the residual branches themselves start small
            )
        for linear in (self.final, self.adaptation_out):
            nn.init.zeros_(linear.weight)
            nn.init.zeros_(linear.bias)
        drawn(self.motion_out.weight, 0.02)
        nn.init.zeros_(self.motion_out.bias)

    @property
    def knows_meshes(self) -> bool:
        """Whether training saw mesh features; else the mesh token must stay the learned null token."""
        return bool(self.notes.get("characters"))

    def condition(
        self,
        text: Tensor | None,
        text_mask: Tensor | None,
        pooled: Tensor | None,
        mesh: Tensor | None,
        keep_text: Tensor,
        keep_mesh: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Memory tokens and the pooled vector, which do not depend on the step.

        Args:
            text: Text tokens, shape (B, L, C); None for none.
            text_mask: True where real, shape (B, L).
            pooled: Sentence vectors, shape (B, P).
            mesh: Mesh features f_phi, shape (B, 448); None where no bank of characters is at hand.
            keep_text: False where the sentence is dropped for classifier-free guidance, shape (B,).
            keep_mesh: False where the mesh feature is unknown, shape (B,).

        Returns:
            Memory (B, 1 + 1 + L, d), its mask (B, 1, 1, 2 + L), pooled (B, d). Token 0 is the mesh, token 1 the learned
            null sentence, which stands only where the sentence is dropped.
        """
        batch, device = len(keep_text), keep_text.device
        null_mesh = self.null_mesh.expand(batch, -1)
        token = (
            null_mesh
            if mesh is None
            else torch.where(keep_mesh[:, None], self.mesh_in(mesh).to(null_mesh.dtype), null_mesh)
        )
        memory = [token[:, None], self.null_text.expand(batch, 1, -1)]
        mask = [torch.ones(batch, 1, dtype=torch.bool, device=device), ~keep_text[:, None]]
        sentence = self.null_pooled.expand(batch, -1)
        if text is not None and text_mask is not None and pooled is not None:
            memory.append(self.text_in(text))
            mask.append(text_mask & keep_text[:, None])
            scaled = self.pooled_in(pooled * math.sqrt(self.config.pooled_size))
            sentence = torch.where(keep_text[:, None], scaled.to(sentence.dtype), sentence)
        return (
            torch.cat([part.to(memory[-1].dtype) for part in memory], dim=1),
            torch.cat(mask, dim=1)[:, None, None],
            sentence,
        )

    def forward(
        self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Clean motion and adaptation [TapMo 2].

        Args:
            x: Noisy motion in network units, shape (B, N, D).
            step: Diffusion step in 0..999, shape (B,).
            lengths: Frames that are real in each row, shape (B,).
            condition: What `condition` returned.

        Returns:
            x0 (B, N, D) in network units and the adaptation of local translations (B, N, K, 3) [m].
        """
        batch, frames, _ = x.shape
        h = self.hidden(x, step, lengths, condition)
        motion = self.motion_out(h).reshape(batch, -1, self.config.features)[:, :frames]
        said = self.adaptation_out(self.adaptation_input(h, condition)).reshape(batch, -1, self.config.handles, 3)[
            :, :frames
        ]
        if self.config.adaptation_frame == "joints":
            said = capped_on_people(joint_offsets(said, motion.detach().float() * self.std + self.mean))
        return motion, said

    def adaptation_input(self, hidden: Tensor, condition: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """What the adaptation's linear layer sees: last hidden states (B, T, d), with the mesh token where the config
        says so.
        """
        if not self.config.adaptation_mesh:
            return hidden
        return torch.cat([hidden, condition[0][:, :1].to(hidden.dtype).expand(-1, hidden.shape[1], -1)], dim=-1)

    def hidden(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """The last hidden states, which both heads read, shape (B, T, d) for T tokens; arguments as in `forward`."""
        batch, frames, _ = x.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        real = torch.arange(tokens * patch, device=x.device) < lengths[:, None]
        x = F.pad(x, (0, 0, 0, tokens * patch - frames)) * real[..., None].to(x.dtype)
        mask = real.view(batch, tokens, patch).any(-1)[:, None, None] if bool((lengths < frames).any()) else None
        memory, memory_mask, sentence = condition
        half = self.config.width // 2
        rates = torch.exp(-math.log(10_000.0) * torch.arange(half, device=x.device) / half)
        angle = step[:, None].float() * rates
        vector = self.step_in(torch.cat([angle.cos(), angle.sin()], dim=-1)) + sentence
        vector = F.silu(vector)
        steer = self.steer(vector).unflatten(-1, (9, -1))
        h = self.motion_in(x.reshape(batch, tokens, patch * self.config.features))
        rotary = _rotary(tokens, self.config.width // self.config.heads, x.device)
        for layer in self.layers:
            h = layer(h, memory, steer, rotary, mask, memory_mask)
        scale, shift = self.final(vector)[:, None].chunk(2, dim=-1)
        return F.layer_norm(h, h.shape[-1:]) * (1 + scale) + shift


def drawn(value: Tensor, deviation: float) -> Tensor:
    """The tensor, filled with normal noise; one on the meta device stays as it is, since torch takes two seconds to
    load what would fill it.
    """
    return value if value.is_meta else nn.init.normal_(value, std=deviation)
