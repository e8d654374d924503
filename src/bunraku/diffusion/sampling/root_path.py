"""Where the root goes: paths that arrive where they should, loops, and motions on the spot."""

from __future__ import annotations

import math

import numpy as np

__all__ = ["arrive"]

STILL = 0.3  # m/s; a loop whose root goes no faster than this, all in all, is meant to stay where it is


def arrive(root: np.ndarray, fps: float, turn: float | None, travel: tuple[float, float] | None) -> np.ndarray:
    """Root velocities changed as little and as evenly as they can be so that they lead to a given place.

    Args:
        root: Yaw velocity [rad/s] and planar velocity in the heading of each frame [m/s], shape (N, 3), as `features`
            has them.
        fps: Frames a second [1/s].
        turn: Turn of all frames together [rad]; None for the nearest whole number of turns.
        travel: Way (x, z) of all frames together [m], seen from the heading before the first; None keeps the way unless
            it is so short that it is meant to be none.

    Returns:
        Shape (N, 3).
    """
    count = len(root)
    weight = np.ones(count)
    if travel is not None:  # little at both ends, so that the velocities stay smooth where these frames meet others
        weight = np.sin(math.pi * (np.arange(count) + 1) / (count + 1))
    weight = (weight / weight.sum()).astype(root.dtype)
    yaw = root[:, 0]
    total = float(yaw.sum()) / fps
    target = round(total / (2 * math.pi)) * 2 * math.pi if turn is None else turn
    yaw = yaw + (target - total) * fps * weight
    angle = yaw.cumsum() / fps
    cos, sin = np.cos(angle), np.sin(angle)
    x, z = root[:, 1] * cos + root[:, 2] * sin, root[:, 2] * cos - root[:, 1] * sin
    displacement = (float(x.sum()) / fps, float(z.sum()) / fps)
    if travel is None:
        travel = displacement if math.hypot(*displacement) > STILL * count / fps else (0.0, 0.0)
    x, z = x + (travel[0] - displacement[0]) * fps * weight, z + (travel[1] - displacement[1]) * fps * weight
    return np.stack([yaw, x * cos - z * sin, z * cos + x * sin], -1).astype(root.dtype)
