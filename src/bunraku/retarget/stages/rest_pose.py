"""How the rest pose of a character is met: limbs are turned and stay joined, and the pelvis of a lying body tilts less:
the stages `rest_pose`, `attach` and `level` of fitting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import attach_joints, reference_joints
from bunraku.body.reference import reference_body
from bunraku.body.residuals import capped
from bunraku.geometry.rotations import axis_angle_from_matrix, heading, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Attach", "Level", "RestPose"]


@dataclass(frozen=True)
class RestPose(Stage):
    """Limbs are rotated from the character's rest direction into the reference body's.

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


@dataclass(frozen=True)
class Attach(Stage):
    """Handles stay joined to their parents.

    Each is joined at the place where its weights and its parent's meet. This takes the place of the learned adaptation
    delta (section 3.2 of TapMo) where bones are longer or shorter than the reference's. Soft bending and shrugs, which
    the motion has beyond stiff joints, are added in the character's scale; rigid blocks have none.
    """

    name: ClassVar[str] = "attach"

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        source, handles, joints = fitting.source, anatomy.handles, anatomy.joints
        rotations, translations = attach_joints(fitting.rotations, handles, joints)
        if handles.rigid:
            return replace(fitting, rotations=rotations, translations=translations)
        stiff = attach_joints(source.rotations.astype(np.float64), reference_body().handles, reference_joints())[1]
        residual = capped(source.translations - stiff, source.soft)
        translations += residual[:, handles.played] * anatomy.scale * joints.present[:, None]
        return replace(fitting, rotations=rotations, translations=translations)
