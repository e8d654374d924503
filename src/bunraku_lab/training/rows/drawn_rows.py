"""Training rows on a device, with all that is told of them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.text import TextBatch

__all__ = ["DrawnRows"]


@dataclass(frozen=True, eq=False)
class DrawnRows:
    """Rows of a batch on one device.

    Args:
        clean: Motions in network units, zero behind their ends, shape (B, N, D).
        lengths: Real frames, shape (B,).
        text: Sentences, encoded.
        mesh: f_phi of each row's character, shape (B, 448); None without a bank.
        known: Whether it is known, shape (B,), bool.
        person: Rows that are of the reference body, shape (B,), bool.
        examples: What the network attends to; None for a network that attends to none.
    """

    clean: Tensor
    lengths: Tensor
    text: TextBatch
    mesh: Tensor | None
    known: Tensor
    person: Tensor
    examples: RetrievedExamples | None
