"""Feet that are long for their legs are held flatter than a person's, instead of the legs folding over them: the stage
`soles` of fitting.

A person's toes point down when a foot leaves the ground, and the ankle is as high as that needs. On a figure whose feet
are as long as its shins the same slope drives the toes into the ground, and a leg that makes up for it walks in a
squat.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.bending import carry, local_motion
from bunraku.anatomy.legs import Leg
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import axis_angle_from_matrix, heading, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.ground import enough
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Soles"]


@dataclass(frozen=True)
class Soles(Stage):
    """Feet that are long for their legs are held flatter where they would sink into the ground.

    Args:
        sinks: A sole may sink so far, over the leg's length: the leg makes up for that by bending.
        steps: Shares of the slope that are tried, before none.
        soft: How long before and after it is needed a foot is flatter [s].
    """

    name: ClassVar[str] = "soles"
    needs: ClassVar[tuple[str, ...]] = ("ground",)

    sinks: float = 0.04
    steps: tuple[float, ...] = (0.75, 0.5, 0.25)
    soft: float = 0.1

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return any(leg.foot for leg in anatomy.legs)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return fitting.moved(self.flatter(fitting.motion, anatomy))

    def flatter(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with feet turned about their ankles towards the level, as far as their soles would sink.

        Args:
            motion: Of the character.
            anatomy: Of the character.
        """
        world, changed = motion.transforms(anatomy.handles.positions).astype(np.float64), False
        for leg in anatomy.legs:
            if not leg.foot:
                continue
            own, shift = world[:, leg.end, :, :3], world[:, leg.end, :, 3]
            ankle = np.einsum("nij,j->ni", own, leg.joints[2]) + shift
            below = ankle[:, 1] - self._under(leg, anatomy, world, ankle) - anatomy.floor
            if (below >= -self.sinks * leg.length).all():
                continue
            turned = own @ anatomy.rotations[leg.end].T
            facing = np.asarray(matrix_y(heading(turned, motion.fps)), np.float64)
            slope = np.asarray(axis_angle_from_matrix(facing.transpose(0, 2, 1) @ turned))
            less = np.where(below < -self.sinks * leg.length, 1.0, 0.0)
            for step in self.steps[::-1]:
                back = self._back(np.full(len(motion), 1 - step), slope, facing, turned)
                clear = ankle[:, 1] - self._under(leg, anatomy, world, ankle, back) - anatomy.floor
                less = np.where((less > 0) & (clear >= -self.sinks * leg.length), np.minimum(less, 1 - step), less)
            back = self._back(enough(less, max(1, round(self.soft * motion.fps))), slope, facing, turned)
            for handle in leg.foot:
                carry(world, handle, anatomy.joints, ankle, ankle, back)
            changed = True
        return local_motion(world, motion, anatomy.handles) if changed else motion

    def _back(self, less: np.ndarray, slope: np.ndarray, facing: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """What takes a foot from its slope to one that is less by a share, shape (N, 3, 3)."""
        kept = facing @ matrix_from_axis_angle((1 - np.minimum(less, 1))[:, None] * slope)
        return np.asarray(kept @ turned.transpose(0, 2, 1))

    def _under(
        self, leg: Leg, anatomy: Anatomy, world: np.ndarray, ankle: np.ndarray, back: np.ndarray | None = None
    ) -> np.ndarray:
        """How far the lowest point of a sole is under its ankle, shape (N,) [m], turned by `back` (N, 3, 3)."""
        mesh, handles = anatomy.mesh, anatomy.mesh_handles
        away = skin(mesh.vertices[leg.sole], handles.weights[leg.sole], world).astype(np.float64) - ankle[:, None]
        heights = away[..., 1] if back is None else np.einsum("nj,nmj->nm", back[:, 1], away)
        return np.asarray(-heights.min(axis=1))
