"""Linear equations whose symmetric matrix has few diagonals, as those of curves in time are."""

from __future__ import annotations

import numpy as np

__all__ = ["solve_banded"]

BLOCK = 48
"""Unknowns that are eliminated at once, by a dense matrix."""


def solve_banded(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve A x = b for a symmetric positive definite A of 2 u + 1 diagonals, block by block.

    Args:
        band: The upper diagonals as `scipy.linalg.solveh_banded` has them: A[i, i + d] stands at [u - d, i + d]; shape
            (u + 1, N).
        right: b, shape (N, C).

    Returns:
        x, shape (N, C), float64.

    Raises:
        numpy.linalg.LinAlgError: A is singular.
    """
    above, count = len(band) - 1, band.shape[1]
    size = max(BLOCK, above)
    more = -count % size  # unknowns that are 0, so that all blocks are alike
    band = np.pad(np.asarray(band, np.float64), ((0, 0), (0, more + size)))
    band[above, count:] = 1
    out = np.pad(np.asarray(right, np.float64), ((0, more), (0, 0)))
    rows, shared = np.arange(size), np.zeros((above, above))
    taken: list[np.ndarray] = []  # what each block takes from the next one's first unknowns
    for start in range(0, len(out), size):
        block = np.zeros((size, size + above))
        for away in range(above + 1):
            block[rows, rows + away] = band[above - away, start + rows + away]
        inner, outer = block[:, :size], block[:, size:]
        inner += np.triu(inner, 1).T
        if start:  # the block before ends in what its last unknowns and these share
            inner[:above, :above] -= shared.T @ taken[-1][-above:]
            out[start : start + above] -= shared.T @ out[start - above : start]
        solved = np.linalg.solve(inner, np.concatenate([outer, out[start : start + size]], axis=1))
        taken.append(solved[:, :above])
        out[start : start + size] = solved[:, above:]
        shared = outer[-above:]
    for start in range(len(out) - 2 * size, -1, -size):
        out[start : start + size] -= taken[start // size] @ out[start + size : start + size + above]
    return out[:count]
