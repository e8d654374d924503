"""Handle motion of a mesh that moves, by weighted rigid registration."""

from __future__ import annotations

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.geometry.registration import register

__all__ = ["handle_motion_of_mesh"]


def handle_motion_of_mesh(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, positions: np.ndarray, areas: np.ndarray, fps: float
) -> HandleMotion:
    """Handle motion of a mesh that moves, by weighted rigid registration (section A.2).

    The root handle's motion is the global one; it is taken off before the other handles are registered, so theirs are
    local.

    Args:
        rest: Rest vertices [m], shape (V, 3).
        posed: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Handle weights, shape (V, K).
        positions: Handle positions [m], shape (K, 3).
        areas: Surface area that each vertex stands for, shape (V,).
        fps: Frames a second [1/s].

    Returns:
        The motion; handles without weight stay at the identity.
    """
    mass = weights * areas[:, None]
    rotations, translations = register(rest, posed, mass[:, :1], positions[:1])
    root_rotation, root_translation = rotations[:, 0], translations[:, 0]
    local = np.einsum("nji,nvj->nvi", root_rotation, posed - positions[0] - root_translation[:, None]) + positions[0]
    rotations, translations = register(rest, local, mass, positions)
    still = mass.sum(axis=0) <= 1e-6 * areas.sum()
    still[0] = True
    rotations[:, still], translations[:, still] = np.eye(3), 0
    return HandleMotion(translations, rotations, root_translation, root_rotation, fps)
