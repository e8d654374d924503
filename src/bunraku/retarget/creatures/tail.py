"""Tails that stream behind: not straight up on a body whose tail rests level.

What horses do, whose tails hang down at rest and stream behind in a gallop, is a turn upwards by a right angle. A tail
that rests level would point to the sky by the same turn.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.stages.attach import Joints

__all__ = ["lowered_tail"]

HIGHEST = np.radians(25)  # a tail that rests lower is held up so far at the most, but for its swings
SLOW = 0.5  # what changes more slowly than this is how a tail is held, and no swing [s]
_TAIL, _TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")


def lowered_tail(rotations: np.ndarray, handles: Handles, joints: Joints, fps: float) -> np.ndarray:
    """Local rotations in which no tail is held up higher than it rests, or higher than `HIGHEST`, whatever is more.

    Args:
        rotations: Of a character's handles from its rest pose, in the root's frame, shape (N, K, 3, 3).
        handles: Its handles.
        joints: Where they meet in its rest pose.
        fps: Frames a second [1/s].
    """
    out = rotations
    for part in (_TAIL, _TIP):
        if not joints.present[part]:
            continue
        along = handles.positions[part].astype(np.float64) - joints.positions[part]
        if part == _TAIL and joints.present[_TIP]:
            along = joints.positions[_TIP] - joints.positions[part]
        if np.hypot(along[1], along[2]) < 0.5 * np.linalg.norm(along):  # it lies across the body
            continue
        rest = float(np.arctan2(along[1], -along[2]))
        posed = rotations[:, part] @ along
        turned = np.arctan2(posed[:, 1], -posed[:, 2]) - rest
        held = gaussian_filter1d(np.unwrap(turned), SLOW * fps, mode="nearest")
        held -= 2 * np.pi * np.round(held.mean() / (2 * np.pi))
        above = np.maximum(rest + held - max(rest, HIGHEST), 0)
        if above.any():
            lower = matrix_from_axis_angle(-above[:, None] * np.array([1.0, 0, 0]))
            out = out.copy() if out is rotations else out
            out[:, part] = lower @ rotations[:, part]
    return out
