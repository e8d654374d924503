"""What a layer of the denoiser is made of: attention to itself, to the sentence and to examples.

The paper's layer is self-attention, cross-attention to the memory and a feed-forward block. A config may add attention
to captured examples that are retrieved for the sentence (ReMoDiffuse, Zhang et al. 2023). Its last linear layer starts
at zero, so a network that gets it says at first what it said without.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.diffusion.denoiser_config import DenoiserConfig

__all__ = ["DecoderLayer", "RetrievedExamples", "drawn", "rotary_positions"]

Rotary = tuple[Tensor, Tensor]


@dataclass(frozen=True, eq=False)
class RetrievedExamples:
    """Captured motions that show what each sentence of a batch says.

    Args:
        values: Network units, zero behind an example's end, shape (B, R, N, D).
        lengths: Real frames, 0 where there is no example, shape (B, R).
        pooled: The vector of each example's own sentence, shape (B, R, P).
    """

    values: Tensor
    lengths: Tensor
    pooled: Tensor

    def rows(self, rows: Tensor) -> RetrievedExamples:
        """Some rows of the batch, in the order that is given."""
        return RetrievedExamples(self.values[rows], self.lengths[rows], self.pooled[rows])

    def to(self, device: torch.device | str) -> RetrievedExamples:
        """The same on a device."""
        return RetrievedExamples(self.values.to(device), self.lengths.to(device), self.pooled.to(device))


def rotary_positions(tokens: Tensor, size: int) -> Rotary:
    """Cosines and sines of rotary positions (Su et al. 2021) of tokens at these places in time, shape (T,), each of
    shape (T, size / 2).
    """
    rates = 1000.0 ** (-torch.arange(0, size, 2, device=tokens.device) / size)
    angle = tokens[:, None] * rates
    return angle.cos(), angle.sin()


def drawn(value: Tensor, deviation: float) -> Tensor:
    """The tensor, filled with normal noise; one on the meta device stays as it is, since torch takes two seconds to
    load what would fill it.
    """
    return value if value.is_meta else nn.init.normal_(value, std=deviation)


def _turn(value: Tensor, rotary: Rotary) -> Tensor:
    first, second = value.chunk(2, dim=-1)
    cos, sin = rotary[0].to(value.dtype), rotary[1].to(value.dtype)
    return torch.cat([first * cos - second * sin, first * sin + second * cos], dim=-1)


def _heads(value: Tensor, heads: int, parts: int = 1) -> tuple[Tensor, ...]:
    """Queries, keys or values of each head, shape (B, H, T, d/H), from as many side by side, shape (B, T, parts d)."""
    return value.unflatten(-1, (parts, heads, -1)).permute(2, 0, 3, 1, 4).unbind()


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


def _without_effect(linear: nn.Linear) -> nn.Linear:
    nn.init.zeros_(linear.weight)
    nn.init.zeros_(linear.bias)
    return linear


class _ExampleAttention(nn.Module):
    """Motion tokens attend to tokens of examples: keys say what an example shows and is called, values what it
    shows.
    """

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.out = _without_effect(nn.Linear(width, width))

    def forward(self, x: Tensor, rotary: Rotary, examples: tuple[Tensor, ...]) -> Tensor:
        """x (B, T, d); keys (B, M, d), values (B, M, d) and mask (B, 1, 1, M) of the examples' tokens, and their
        rotary positions.
        """
        keys, values, mask, cos, sin = examples
        query, key = _heads(self.query(x), self.heads)[0], _heads(self.key(keys), self.heads)[0]
        value = _heads(self.value(values), self.heads)[0]
        mixed = _attend(_turn(query, rotary), _turn(key, (cos, sin)), value, mask)
        out: Tensor = self.out(mixed.transpose(1, 2).flatten(2))
        return out


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention, feed-forward; each behind an adaptive norm and a gate.

    Args:
        config: Sizes.
        examples: Whether this layer attends to examples.
    """

    def __init__(self, config: DenoiserConfig, examples: bool = False):
        super().__init__()
        width = config.width
        self.heads = config.heads
        self.offset = nn.Parameter(torch.zeros(9, width))
        self.self_in, self.self_out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.cross_query, self.cross_memory, self.cross_out = (
            nn.Linear(width, width),
            nn.Linear(width, 2 * width),
            nn.Linear(width, width),
        )
        self.wide, self.narrow = nn.Linear(width, config.feedforward), nn.Linear(config.feedforward, width)
        self.offset_more = nn.Parameter(torch.zeros(3, width)) if config.examples else None
        self.examples = _ExampleAttention(width, config.heads) if examples else None

    def forward(
        self,
        x: Tensor,
        memory: Tensor,
        steer: Tensor,
        rotary: Rotary,
        mask: Tensor | None,
        memory_mask: Tensor | None,
        examples: tuple[Tensor, ...] = (),
    ) -> Tensor:
        """x (B, T, d), memory (B, M, d), steer (B, 9, or 12 with examples, d), masks (B, 1, 1, T) and (B, 1, 1,
        M), True where real.
        """
        own = (steer[:, :9] + self.offset).to(x.dtype).unsqueeze(2).unbind(1)
        more: tuple[Tensor, ...] = ()
        if self.offset_more is not None:
            more = (steer[:, 9:] + self.offset_more).to(x.dtype).unsqueeze(2).unbind(1)

        def norm(parts: tuple[Tensor, ...], index: int) -> Tensor:
            return F.layer_norm(x, x.shape[-1:]) * (1 + parts[index]) + parts[index + 1]

        query, key, value = _heads(self.self_in(norm(own, 0)), self.heads, 3)
        mixed = _attend(_turn(query, rotary), _turn(key, rotary), value, mask)
        x = x + own[2] * self.self_out(mixed.transpose(1, 2).flatten(2))
        (query,) = _heads(self.cross_query(norm(own, 3)), self.heads)
        key, value = _heads(self.cross_memory(memory), self.heads, 2)
        mixed = _attend(query, key, value, memory_mask)
        x = x + own[5] * self.cross_out(mixed.transpose(1, 2).flatten(2))
        if self.examples is not None and examples:
            x = x + more[2] * self.examples(norm(more, 0), rotary, examples)
        return x + own[8] * self.narrow(F.gelu(self.wide(norm(own, 6))))
