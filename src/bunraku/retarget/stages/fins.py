"""Fins, claws and forelegs that nobody drew: held as they rest, where a generator knows nothing of them.

What is drawn for a body without arms has arms that go with its trunk, and on the reference body these stand out to the
sides. What is drawn for a person has arms that hang, and the fins of a whale would hang as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints, downwards
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Handles
from bunraku.geometry.filters import gaussian
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.handles.limbs import FAMILIES, SIDES, further_legged, limb_handles
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Fins"]

_CHEST = HANDLE_NAMES.index("spine3")
_ARMS = [limb_handles(side, FAMILIES[1]) for side in SIDES]
_PARTS = [part for arm in _ARMS for part in arm]


@dataclass(frozen=True)
class Fins(Stage):
    """Fins, claws and forelegs that nothing was drawn for stay near their rest.

    Args:
        undrawn: Arms that are off the trunk's turn by no more on average were not drawn [rad].
        aside: Each part of a fin is held so far from its rest at the most, but for its swings [rad].
        slow: What changes more slowly than this is how a fin is held, and no swing [s].
    """

    name: ClassVar[str] = "fins"
    needs: ClassVar[tuple[str, ...]] = ("rest_pose",)

    undrawn: float = float(np.radians(6))
    aside: float = float(np.radians(10))
    slow: float = 0.5

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        if not fitting.source.own_kind or anatomy.upright:
            return False
        return not anatomy.legs or further_legged(anatomy.handles) or not self.drawn(fitting.source.rotations)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        drawn = self.drawn(fitting.source.rotations)
        held = self.held(fitting.rotations, anatomy.handles, anatomy.joints, drawn, fitting.source.fps)
        return replace(fitting, rotations=held)

    def drawn(self, rotations: np.ndarray) -> bool:
        """Whether arms move of their own in a motion of the reference body, whose rotations (N, 30, 3, 3) are given."""
        chest = rotations[:, _CHEST].astype(np.float64).transpose(0, 2, 1)
        upper = [handle for arm in _ARMS for handle in arm[:2]]
        turns = axis_angle_from_matrix(chest[:, None] @ rotations[:, upper].astype(np.float64))
        return bool(np.linalg.norm(turns, axis=-1).mean() > self.undrawn)

    def held(self, rotations: np.ndarray, handles: Handles, joints: Joints, drawn: bool, fps: float) -> np.ndarray:
        """Local rotations in which arms rest where they were not drawn, and are held near their rest where they were.

        Args:
            rotations: Of a character's handles from its rest pose, in the root's frame, shape (N, K, 3, 3).
            handles: Its handles.
            joints: Where they meet.
            drawn: Whether its arms were drawn.
            fps: Frames a second [1/s].
        """
        before = rotations.astype(np.float64)
        out = before.copy()
        for handle in downwards(joints.parents):
            if int(handles.played[handle]) in _PARTS and joints.present[handle]:
                parent = int(joints.parents[handle])
                turned = before[:, parent].transpose(0, 2, 1) @ before[:, handle]
                out[:, handle] = out[:, parent] @ self._nearer(turned, fps) if drawn else out[:, parent]
        return out

    def _nearer(self, turned: np.ndarray, fps: float) -> np.ndarray:
        """Turns from rest (N, 3, 3) of which no more than `aside` is left of what lasts."""
        lasts = gaussian(np.asarray(axis_angle_from_matrix(turned)), self.slow * fps)
        angle = np.linalg.norm(lasts, axis=-1, keepdims=True)
        kept = matrix_from_axis_angle(lasts * np.minimum(1, self.aside / np.maximum(angle, 1e-9)))
        return np.asarray(kept @ matrix_from_axis_angle(lasts).transpose(0, 2, 1) @ turned)
