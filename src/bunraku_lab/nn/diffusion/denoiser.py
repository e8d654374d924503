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
from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.diffusion.features import ROOT_SIZE
from bunraku.diffusion.inference.examples import EXAMPLE_TOKENS
from bunraku.geometry.rotations import matrix_from_6d
from bunraku_lab.nn.diffusion.denoiser_layers import DecoderLayer, RetrievedExamples, drawn, rotary_positions
from bunraku_lab.nn.residuals import capped_on_people

__all__ = ["Denoiser", "joint_offsets"]


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
        # of two neighbouring layers the second looks at retrieved examples
        self.layers = nn.ModuleList(
            DecoderLayer(config, examples=config.examples > 0 and index % 2 == 1) for index in range(config.layers)
        )
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
        _open_gates(self.steer)
        self.steer_more = nn.Linear(width, 3 * width) if config.examples else None
        if self.steer_more is not None:
            _open_gates(self.steer_more)
        if config.examples:
            self.example_in = nn.Linear(config.features * patch * EXAMPLE_TOKENS, width)
            self.example_sentence_in = nn.Linear(config.pooled_size, width)
            self.null_example = nn.Parameter(drawn(torch.empty(width), 0.02))
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
        examples: RetrievedExamples | None = None,
    ) -> tuple[Tensor, ...]:
        """Memory tokens and the pooled vector, which do not depend on the step.

        Args:
            text: Text tokens, shape (B, L, C); None for none.
            text_mask: True where real, shape (B, L).
            pooled: Sentence vectors, shape (B, P).
            mesh: Mesh features f_phi, shape (B, 448); None where no bank of characters is at hand.
            keep_text: False where the sentence is dropped for classifier-free guidance, shape (B,).
            keep_mesh: False where the mesh feature is unknown, shape (B,).
            examples: Captured examples of the sentences; they are dropped with them. None for none.

        Returns:
            Memory (B, 1 + 1 + L, d), its mask (B, 1, 1, 2 + L), pooled (B, d). Token 0 is the mesh, token 1 the learned
            null sentence, which stands only where the sentence is dropped. A network that attends to examples adds
            their keys and values, (B, 1 + M, d), and their mask (B, 1, 1, 1 + M).
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
        condition = (
            torch.cat([part.to(memory[-1].dtype) for part in memory], dim=1),
            torch.cat(mask, dim=1)[:, None, None],
            sentence,
        )
        return condition if not self.config.examples else condition + self._example_tokens(examples, keep_text)

    def _example_tokens(self, examples: RetrievedExamples | None, keep: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Keys, values and mask of the examples' tokens; token 0 is the learned null example, which is always there."""
        null = self.null_example.expand(len(keep), 1, -1)
        always = torch.ones(len(keep), 1, dtype=torch.bool, device=keep.device)
        if examples is None:
            return null, null, always[:, None, None]
        size = self.config.frames_per_token * EXAMPLE_TOKENS
        tokens = -(-examples.values.shape[2] // size)
        frames = F.pad(examples.values, (0, 0, 0, tokens * size - examples.values.shape[2]))
        real = torch.arange(tokens * size, device=keep.device) < examples.lengths[..., None]
        values = self.example_in((frames * real[..., None].to(frames.dtype)).unflatten(2, (tokens, size)).flatten(3))
        sentence = self.example_sentence_in(examples.pooled * math.sqrt(self.config.pooled_size))
        keys = values + sentence[:, :, None].to(values.dtype)
        mask = real.unflatten(2, (tokens, size)).any(-1).flatten(1) & keep[:, None]
        null = null.to(values.dtype)
        return (
            torch.cat([null, keys.flatten(1, 2)], dim=1),
            torch.cat([null, values.flatten(1, 2)], dim=1),
            torch.cat([always, mask], dim=1)[:, None, None],
        )

    def _example_rotary(self, tokens: int, size: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Rotary positions of the examples' tokens, each example from its own start; the null example stands there."""
        own = EXAMPLE_TOKENS * torch.arange((tokens - 1) // self.config.examples, device=device)
        return rotary_positions(torch.cat([own.new_zeros(1), own.repeat(self.config.examples)])[:tokens], size)

    def forward(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
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

    def adaptation_input(self, hidden: Tensor, condition: tuple[Tensor, ...]) -> Tensor:
        """What the adaptation's linear layer sees: last hidden states (B, T, d), with the mesh token where the config
        says so.
        """
        if not self.config.adaptation_mesh:
            return hidden
        return torch.cat([hidden, condition[0][:, :1].to(hidden.dtype).expand(-1, hidden.shape[1], -1)], dim=-1)

    def hidden(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, ...]) -> Tensor:
        """The last hidden states, which both heads read, shape (B, T, d) for T tokens; arguments as in `forward`."""
        batch, frames, _ = x.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        real = torch.arange(tokens * patch, device=x.device) < lengths[:, None]
        x = F.pad(x, (0, 0, 0, tokens * patch - frames)) * real[..., None].to(x.dtype)
        mask = real.view(batch, tokens, patch).any(-1)[:, None, None] if bool((lengths < frames).any()) else None
        memory, memory_mask, sentence, *found = condition
        half = self.config.width // 2
        rates = torch.exp(-math.log(10_000.0) * torch.arange(half, device=x.device) / half)
        angle = step[:, None].float() * rates
        vector = self.step_in(torch.cat([angle.cos(), angle.sin()], dim=-1)) + sentence
        vector = F.silu(vector)
        steer = self.steer(vector).unflatten(-1, (9, -1))
        if self.steer_more is not None:
            steer = torch.cat([steer, self.steer_more(vector).unflatten(-1, (-1, self.config.width))], dim=1)
        h = self.motion_in(x.reshape(batch, tokens, patch * self.config.features))
        size = self.config.width // self.config.heads
        rotary = rotary_positions(torch.arange(tokens, device=x.device), size)
        if found:
            found += self._example_rotary(found[0].shape[1], size, x.device)
        for layer in self.layers:
            h = layer(h, memory, steer, rotary, mask, memory_mask, tuple(found))
        scale, shift = self.final(vector)[:, None].chunk(2, dim=-1)
        return F.layer_norm(h, h.shape[-1:]) * (1 + scale) + shift


@torch.no_grad()
def _open_gates(steer: nn.Linear) -> None:
    """Scales and shifts start near zero and gates open: the residual branches themselves start small."""
    steer.weight.mul_(0.1)
    steer.bias.zero_()
    steer.bias.view(-1, 3, steer.in_features)[:, 2] = 1
