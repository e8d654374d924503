"""Jitter taken out of generated motion: the stage `smooth` of fitting.

A generator leaves a floor of noise near the highest frequency that its frames can hold; on a body that stands still it
is seen as shimmer. Each signal is split by a zero-phase low-pass filter, and the fast part is kept only as far as its
local power exceeds the clip's own noise floor (a Wiener filter in time). Where a motion is fast, as in a punch, the
fast part is far over the floor and stays; a captured clip whose floor is low stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.motion import HandleMotion
from bunraku.geometry.filters import correlated, gaussian
from bunraku.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Smooth"]

KERNEL = (
    np.array([-1, 4, 10, 4, -1]) / 16
)  # maximally flat: keeps cubic motion as it is, and nothing at half the frame rate


@dataclass(frozen=True)
class Smooth(Stage):
    """The generator's noise is taken out; fast moves stay.

    Args:
        local: Over how long power is measured [s].
        floor: The noise floor is exceeded by the power of all frames but this share.
        margin: Power under so many times the floor is noise.
        most_turn: The floor is no higher than this in an entry of a rotation; captured clips have more detail.
        most_shift: Likewise of a position [m].
        least: Shorter clips have no floor to be measured [frames].
    """

    name: ClassVar[str] = "smooth"

    local: float = 0.1
    floor: float = 0.25
    margin: float = 4.0
    most_turn: float = 0.003
    most_shift: float = 0.0006
    least: int = 5

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return Fitting.of(self.smoothed(fitting.source), anatomy, fitting.heights)

    def _cored(self, signal: np.ndarray, most: float, fps: float) -> np.ndarray:
        """A signal (N, ..., C) without what is fast and weak in it; the C channels share their power."""
        slow = correlated(signal, KERNEL, edge="mirror")
        fast = signal - slow
        power = gaussian((fast**2).mean(axis=-1), self.local * fps)
        floor = np.minimum(np.quantile(power, self.floor, axis=0), most**2)
        gain = np.maximum(0, 1 - self.margin * floor / np.maximum(power, 1e-20))
        return np.asarray(slow + gain[..., None] * fast)

    def smoothed(self, motion: HandleMotion) -> HandleMotion:
        """The motion of the reference body without its jitter; fast moves keep their speed.

        Args:
            motion: N frames of K handles.
        """
        if len(motion) < self.least:
            return motion
        fps = motion.fps
        rotations = matrix_from_6d(self._cored(matrix_to_6d(motion.rotations.astype(np.float64)), self.most_turn, fps))
        root = matrix_from_6d(self._cored(matrix_to_6d(motion.root_rotation.astype(np.float64)), self.most_turn, fps))
        translations = self._cored(motion.translations.astype(np.float64), self.most_shift, fps)
        rotations[:, 0], translations[:, 0] = np.eye(3), 0
        path = self._cored(motion.root_translation.astype(np.float64), self.most_shift, fps)
        return replace(
            motion, rotations=rotations, translations=translations, root_rotation=root, root_translation=path
        )
