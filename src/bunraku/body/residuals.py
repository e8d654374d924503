"""How far parts may leave their joints: what local translations hold beyond stiff joints is cut to it."""

from __future__ import annotations

import numpy as np

__all__ = ["LOOSE", "LOOSE_ON_PEOPLE", "capped"]

LOOSE = 0.5
"""How far parts of soft bodies, and loose parts, may leave their joints [m of the reference body]."""
LOOSE_ON_PEOPLE = 0.05
"""How far parts of people may: what is more is an error of the generator, and no motion [m of the reference body]."""


def capped(residual: np.ndarray, soft: bool) -> np.ndarray:
    """What local translations hold beyond stiff joints, cut to what parts may leave them by, in the reference's metres
    (..., 3).

    Args:
        residual: Shape (..., 3).
        soft: Whether parts may go farther than those of people.
    """
    length = np.linalg.norm(residual, axis=-1, keepdims=True)
    return np.asarray(residual * np.minimum(1, (LOOSE if soft else LOOSE_ON_PEOPLE) / np.maximum(length, 1e-9)))
