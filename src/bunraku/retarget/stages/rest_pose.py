"""How the rest pose of a character is met: limbs are turned, and the pelvis of a lying body tilts less."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.geometry.heading import heading
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Level", "RestPose"]


@dataclass(frozen=True)
class RestPose(Stage):
    """Limbs are turned from the character's rest direction into the reference body's.

    A limb that rests in another direction (arms down, A-pose, sitting, the front legs of a dog) is first turned into
    the reference's, so the motion means the same (`Anatomy.rotations`).
    """

    name: ClassVar[str] = "rest_pose"

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return replace(fitting, rotations=fitting.rotations @ anatomy.rotations)


@dataclass(frozen=True)
class Level(Stage):
    """Bodies that lie along their spine take a third of a person's tilt of the pelvis.

    A person bends over by tilting the pelvis; on a body that lies along its spine the same tilt would stand it on its
    head. The turn about +Y stays whole.

    Args:
        parts: Of so many parts of the tilt one is kept.
    """

    name: ClassVar[str] = "level"
    needs: ClassVar[tuple[str, ...]] = ("rest_pose",)

    parts: float = 3

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return not fitting.source.own_kind and not anatomy.upright

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        root = fitting.source.root_rotation
        facing = matrix_y(heading(root, fitting.source.fps))
        tilt = axis_angle_from_matrix(facing.transpose(0, 2, 1) @ root)
        return replace(fitting, root_rotation=np.asarray(facing @ matrix_from_axis_angle(tilt / self.parts)))
