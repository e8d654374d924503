"""Snakes that lie on the ground: what is drawn for them turns level, and only the front of the body rises.

By the way that a bull lowers its horns a snake would stand on its head, and by that of a rat its middle would hang in
the air.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import (
    heading,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    matrix_y,
    quaternion_from_matrix,
    quaternion_slerp,
)

__all__ = ["laid"]

_LINE = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "tail", "tail_tip")]
_FRONT = [HANDLE_NAMES.index(name) for name in ("neck", "head", "head_top", "face")]
"""Parts that may rise."""


def laid(motion: HandleMotion, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations (N, 30, 3, 3) and those of the root (N, 3, 3) in which a long body without legs keeps to the
    ground: its root does not tilt, its parts turn aside only, and its neck and head no farther down than they rest.

    Args:
        motion: Of the reference body.
        share: How much of that is done in each frame, 0 to 1, shape (N,).
    """
    root = motion.root_rotation.astype(np.float64)
    facing = np.asarray(matrix_y(heading(root, motion.fps)), np.float64)
    flat = _blend(root, facing, share)
    seen = flat.transpose(0, 2, 1) @ root  # what is left of the tilt is for the parts to keep
    rotations = motion.rotations.astype(np.float64).copy()
    for part in (*_LINE, *_FRONT):
        turned = seen @ rotations[:, part]
        ahead = turned[:, :, 2]
        level = np.asarray(matrix_y(np.arctan2(ahead[:, 0], ahead[:, 2])), np.float64)
        if part in _FRONT:
            up = np.maximum(np.arctan2(ahead[:, 1], np.hypot(ahead[:, 0], ahead[:, 2])), 0)
            level = level @ matrix_from_axis_angle(-up[:, None] * np.array([1.0, 0, 0]))
        rotations[:, part] = _blend(turned, level, share)
    return rotations, flat


def _blend(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) so far from one to another."""
    return np.asarray(
        matrix_from_quaternion(quaternion_slerp(quaternion_from_matrix(start), quaternion_from_matrix(end), share))
    )
