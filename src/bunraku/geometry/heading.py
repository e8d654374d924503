"""Where a body faces, from the rotation of its root."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.geometry.rotations import quaternion_from_matrix

__all__ = ["heading"]


def heading(root_rotation: np.ndarray, fps: float = 20.0) -> np.ndarray:
    """Where the root faces: its turn about +Y, unwrapped and smooth.

    The turn is the twist of the rotation about +Y, which stays well defined for a body lying on its back, front or
    side, unlike the projection of +Z, with which it agrees when upright. It is lost only upside down: each frame counts
    by how well defined it is in a Gaussian mean over 0.1 s, and stretches without any are bridged.

    Args:
        root_rotation: Rotations, shape (N, 3, 3).
        fps: Frames a second [1/s].

    Returns:
        Angles [rad], shape (N,), float64; 0 faces +Z, positive turns towards +X. Always finite.
    """
    quaternion = quaternion_from_matrix(np.asarray(root_rotation, float))
    y, w = quaternion[:, 1], quaternion[:, 3]
    vector = np.stack([w * w - y * y, 2 * w * y], -1)  # (cos, sin) of the twist times w^2 + y^2
    vector = gaussian_filter1d(vector, 0.1 * fps, axis=0, mode="nearest")
    sure = np.hypot(vector[:, 0], vector[:, 1]) > 0.05
    if not sure.any():
        return np.zeros(len(vector))
    frames = np.arange(len(vector))
    return np.interp(frames, frames[sure], np.unwrap(np.arctan2(vector[sure, 1], vector[sure, 0])))
