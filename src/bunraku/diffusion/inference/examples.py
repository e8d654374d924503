"""Captured examples as a denoiser that attends to them sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["EXAMPLE_TOKENS", "RetrievedExamples"]

EXAMPLE_TOKENS = 2
"""Motion tokens whose frames share one token of an example: examples need less detail, and attention to them is half
of its price.
"""


@dataclass(frozen=True, eq=False)
class RetrievedExamples:
    """Captured motions that show what each sentence of a batch says.

    Args:
        values: Network units, zero behind an example's end, shape (B, R, N, D).
        lengths: Real frames, 0 where there is no example, shape (B, R).
        pooled: The vector of each example's own sentence, shape (B, R, P).
    """

    values: np.ndarray
    lengths: np.ndarray
    pooled: np.ndarray

    def rows(self, rows: np.ndarray) -> RetrievedExamples:
        """Some rows of the batch, in the order that is given."""
        return RetrievedExamples(self.values[rows], self.lengths[rows], self.pooled[rows])
