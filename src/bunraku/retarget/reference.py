"""From a character to the reference body: the way back of `fit_motion`, for motions that other characters bring."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import attach_joints, downwards, reference_joints
from bunraku.anatomy.limbs import reference_parts
from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.body.reference import reference_body
from bunraku.body.residuals import capped
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin

__all__ = ["motion_to_reference"]

_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]


def motion_to_reference(motion: HandleMotion, anatomy: Anatomy, own: bool = False) -> HandleMotion:
    """A handle motion of a character as the one of the reference body that `fit_motion` of such a motion without
    its ground stages takes back to the character's.

    Limbs turn back from the character's rest directions, parts that the character lacks move with their parents,
    and what its parts do beyond stiff joints is carried over in the reference's scale. Of several limbs that play
    one part, the first speaks for all. The root's path keeps its height over the floor that the character's rest
    pose stands on.

    Args:
        motion: Motion of the character's handles.
        anatomy: Of the character, in the pose that the motion is relative to.
        own: The motion stays one of this very body. Otherwise it becomes a person's: parts stay closer to their
            joints, there is no tail, and the reference body stands on y = 0.

    Returns:
        The motion of the reference body's handles.
    """
    handles, joints = anatomy.handles, anatomy.joints
    parents, present = reference_parts(handles, joints)
    rotations = motion.rotations.astype(np.float64) @ anatomy.rotations.transpose(0, 2, 1)
    stiff = attach_joints(motion.rotations.astype(np.float64), handles, joints)[1]
    residual = (motion.translations - stiff) / anatomy.scale * present[:, None]
    residual[:, 0] = 0
    for handle in downwards(HANDLE_PARENTS):
        if not present[handle] and handle:
            rotations[:, handle] = rotations[:, max(int(parents[handle]), 0)]
    translations = attach_joints(rotations, reference_body().handles, reference_joints())[1] + capped(residual, own)
    path = motion.root_translation - np.array([0, anatomy.rise, 0])
    path = (path - (motion.root_rotation - np.eye(3)) @ anatomy.lever) / anatomy.scale
    result = replace(motion, rotations=rotations, translations=translations, root_translation=path)
    return result if own else _as_person(result)


def _as_person(motion: HandleMotion) -> HandleMotion:
    """The motion without a tail, and moved along Y so that the reference body stands on y = 0."""
    body = reference_body()
    changed: dict[str, Any] = {"rotations": motion.rotations.copy(), "translations": motion.translations.copy()}
    changed["rotations"][:, _TAIL], changed["translations"][:, _TAIL] = np.eye(3), 0
    result = replace(motion, **changed)
    lowest = skin(body.vertices, body.handle_weights, result.transforms(body.handles.positions))[..., 1].min(axis=1)
    return replace(
        result, root_translation=motion.root_translation - np.array([0, np.quantile(lowest, 0.05), 0], np.float32)
    )
