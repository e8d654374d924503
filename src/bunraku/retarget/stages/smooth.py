"""Jitter taken out of generated motion: the stage `smooth` of fitting.

A generator leaves a floor of noise near the highest frequency that its frames can hold; on a body that stands still it
is seen as shimmer. Each signal is split by a zero-phase low-pass filter, and the fast part is kept only as far as its
local power exceeds the clip's own noise floor (a Wiener filter in time). Where a motion is fast, as in a punch, the
fast part is far over the floor and stays; a captured clip whose floor is low stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d, gaussian_filter1d

from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_6d, matrix_to_6d

__all__ = ["smooth"]

KERNEL = (
    np.array([-1, 4, 10, 4, -1]) / 16
)  # maximally flat: keeps cubic motion as it is, and nothing at half the frame rate
LOCAL = 0.1  # over how long power is measured [s]
FLOOR = 0.25  # the floor is exceeded by the power of all frames but this share
MARGIN = 4.0  # power under so many times the floor is noise
MOST_TURN, MOST_SHIFT = (
    0.003,
    0.0006,
)  # a floor is no higher than this, in an entry of a rotation and [m]; captured clips have more detail than that
LEAST = 5  # frames: shorter clips have no floor to be measured


def _cored(signal: np.ndarray, most: float, fps: float) -> np.ndarray:
    """A signal (N, ..., C) without what is fast and weak in it; the C channels share their power."""
    slow = convolve1d(signal, KERNEL, axis=0, mode="mirror")
    fast = signal - slow
    power = gaussian_filter1d((fast**2).mean(axis=-1), LOCAL * fps, axis=0, mode="nearest")
    floor = np.minimum(np.quantile(power, FLOOR, axis=0), most**2)
    gain = np.maximum(0, 1 - MARGIN * floor / np.maximum(power, 1e-20))
    return np.asarray(slow + gain[..., None] * fast)


def smooth(motion: HandleMotion) -> HandleMotion:
    """The motion of the reference body without its jitter; fast moves keep their speed.

    Args:
        motion: N frames of K handles.
    """
    if len(motion) < LEAST:
        return motion
    fps = motion.fps
    rotations = matrix_from_6d(_cored(matrix_to_6d(motion.rotations.astype(np.float64)), MOST_TURN, fps))
    root = matrix_from_6d(_cored(matrix_to_6d(motion.root_rotation.astype(np.float64)), MOST_TURN, fps))
    translations = _cored(motion.translations.astype(np.float64), MOST_SHIFT, fps)
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    path = _cored(motion.root_translation.astype(np.float64), MOST_SHIFT, fps)
    return replace(motion, rotations=rotations, translations=translations, root_rotation=root, root_translation=path)
