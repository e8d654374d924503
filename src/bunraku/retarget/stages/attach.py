"""Handles stay joined to their parents: the stage `attach` of fitting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import attach_joints, reference_joints
from bunraku.body.reference import reference_body
from bunraku.body.residuals import capped
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Attach"]


@dataclass(frozen=True)
class Attach(Stage):
    """Handles stay joined to their parents.

    Each is joined at the place where its weights and its parent's meet. This takes the place of the learned adaptation
    delta (section 3.2 of TapMo) where bones are longer or shorter than the reference's. Soft bending and shrugs, which
    the motion has beyond stiff joints, are added in the character's scale.
    """

    name: ClassVar[str] = "attach"

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        source, handles, joints = fitting.source, anatomy.handles, anatomy.joints
        rotations, translations = attach_joints(fitting.rotations, handles, joints)
        stiff = attach_joints(source.rotations.astype(np.float64), reference_body().handles, reference_joints())[1]
        residual = capped(source.translations - stiff, source.soft)
        translations += residual[:, handles.played] * anatomy.scale * joints.present[:, None]
        return replace(fitting, rotations=rotations, translations=translations)
