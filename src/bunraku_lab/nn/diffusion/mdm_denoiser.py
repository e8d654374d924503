"""The denoiser that TapMo is compared with, "TapMo (MDM)" of its Table 1: MDM's transformer encoder with one text
token.

As in MDM (Tevet et al. 2022) the sentence's one vector and the diffusion step are summed into a single token, here with
the mesh feature, which stands before the motion tokens and is all that tells them what to do: no cross-attention, no
tokens of words, no adaptive norm. Positions are sinusoidal. Width, layers, frames a token, heads and both outputs are
those of `Denoiser`; the feed-forward blocks are wider by twice the width, which takes the place of cross-attention, so
that both networks have about the same number of parameters.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples, drawn

__all__ = ["EncoderDenoiser"]


class _EncoderLayer(nn.Module):
    """A pre-norm transformer encoder layer."""

    def __init__(self, width: int, heads: int, feedforward: int):
        super().__init__()
        self.heads = heads
        self.norm_a, self.norm_b = nn.LayerNorm(width), nn.LayerNorm(width)
        self.self_in, self.self_out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.wide, self.narrow = nn.Linear(width, feedforward), nn.Linear(feedforward, width)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """x (B, T, d), mask (B, 1, 1, T), True where real."""
        query, key, value = (
            part.unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for part in self.self_in(self.norm_a(x)).chunk(3, dim=-1)
        )
        if torch.is_grad_enabled() and x.device.type == "cpu":  # torch's fused backward is slow there, see `Denoiser`
            scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
            scores = scores if mask is None else scores.masked_fill(~mask, -1e4)
            mixed = torch.softmax(scores, dim=-1, dtype=scores.dtype) @ value
        else:
            mixed = F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        x = x + self.self_out(mixed.transpose(1, 2).flatten(2))
        return x + self.narrow(F.gelu(self.wide(self.norm_b(x))))


def _waves(angle: Tensor, width: int) -> Tensor:
    """Cosines and sines of numbers of shape (A,), shape (A, width)."""
    half = width // 2
    rates = torch.exp(-math.log(10_000.0) * torch.arange(half, device=angle.device) / half)
    turned = angle[:, None].float() * rates
    return torch.cat([turned.cos(), turned.sin()], dim=-1)


class EncoderDenoiser(Denoiser):
    """Predicts x0 and the adaptation like `Denoiser`, and is trained and sampled in its place."""

    def __init__(self, config: DenoiserConfig):
        super().__init__(replace(config, layers=0, convolution=0, examples=0))
        self.config = config
        for unused in ("text_in", "null_text", "steer", "final"):
            delattr(self, unused)
        width = config.width
        inner = config.feedforward + 2 * width
        self.layers = nn.ModuleList(_EncoderLayer(width, config.heads, inner) for _ in range(config.layers))
        self.norm_out = nn.LayerNorm(width)
        for layer in self.layers:
            for name in ("self_out", "narrow"):
                linear = getattr(layer, name)
                drawn(linear.weight, 0.02 / math.sqrt(2 * config.layers))
                nn.init.zeros_(linear.bias)

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
        """The one token, as a memory of one, but for the step that `forward` adds.

        Args:
            text: Word tokens, which this network does not look at.
            text_mask: Their mask.
            pooled: Sentence vectors, shape (B, P); None for none.
            mesh: Mesh features f_phi, shape (B, 448), or None.
            keep_text: False where the sentence is dropped, shape (B,).
            keep_mesh: False where the mesh feature is unknown, shape (B,).
            examples: Captured examples, which this network does not look at.

        Returns:
            The token (B, 1, d), its mask (B, 1, 1, 1), the sentence's share of it (B, d).
        """
        batch = len(keep_text)
        sentence, shape = self.null_pooled.expand(batch, -1), self.null_mesh.expand(batch, -1)
        if pooled is not None:
            scaled = self.pooled_in(pooled * math.sqrt(self.config.pooled_size))
            sentence = torch.where(keep_text[:, None], scaled.to(sentence.dtype), sentence)
        if mesh is not None:
            shape = torch.where(keep_mesh[:, None], self.mesh_in(mesh).to(shape.dtype), shape)
        mask = torch.ones(batch, 1, 1, 1, dtype=torch.bool, device=keep_text.device)
        return (sentence + shape)[:, None], mask, sentence

    def hidden(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, ...]) -> Tensor:
        """The last hidden states, which both heads read, shape (B, T, d); arguments as in `Denoiser.forward`."""
        batch, frames, _ = x.shape
        patch, width = self.config.frames_per_token, self.config.width
        tokens = -(-frames // patch)
        real = torch.arange(tokens * patch, device=x.device) < lengths[:, None]
        x = F.pad(x, (0, 0, 0, tokens * patch - frames)) * real[..., None].to(x.dtype)
        mask = None
        if bool((lengths < frames).any()):
            mask = F.pad(real.view(batch, tokens, patch).any(-1), (1, 0), value=True)[:, None, None]
        token = condition[0] + self.step_in(_waves(step, width))[:, None]
        h = self.motion_in(x.reshape(batch, tokens, patch * self.config.features))
        h = torch.cat([token.to(h.dtype), h], dim=1)
        h = h + _waves(torch.arange(tokens + 1, device=x.device), width).to(h.dtype)
        for layer in self.layers:
            h = layer(h, mask)
        out: Tensor = self.norm_out(h[:, 1:])
        return out
