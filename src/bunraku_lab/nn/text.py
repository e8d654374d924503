"""Encoded sentences as tensors, for training: what `language.encoders` gives as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bunraku.language import encoders

__all__ = ["TextBatch", "tensors_of"]


@dataclass(frozen=True)
class TextBatch:
    """Encoded sentences, as `language.encoders.TextBatch`.

    Args:
        tokens: Shape (B, L, C).
        mask: True where a token is real, shape (B, L).
        pooled: One vector a sentence, shape (B, P).
    """

    tokens: Tensor
    mask: Tensor
    pooled: Tensor

    def to(self, device: torch.device | str) -> TextBatch:
        """The same on a device."""
        return TextBatch(self.tokens.to(device), self.mask.to(device), self.pooled.to(device))

    def arrays(self) -> encoders.TextBatch:
        """The same as arrays."""
        return encoders.TextBatch(*(part.cpu().numpy() for part in (self.tokens, self.mask, self.pooled)))


def tensors_of(batch: encoders.TextBatch) -> TextBatch:
    """Encoded sentences as tensors."""
    return TextBatch(*(torch.from_numpy(part) for part in (batch.tokens, batch.mask, batch.pooled)))
