"""From a character to the reference body: the way back of `fit_motion`, for motions that other characters bring."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.anatomy.decimate import decimated
from bunraku.anatomy.ground import standing, stride_scale
from bunraku.anatomy.joints import Joints, attach_joints, downwards, reference_joints
from bunraku.anatomy.limbs import reference_parts
from bunraku.anatomy.stance import rest_to_reference, stance_of
from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.body.reference import reference_body
from bunraku.body.residuals import capped
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin

__all__ = ["WayBack", "motion_to_reference"]

_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]


@dataclass(frozen=True, eq=False)
class WayBack:
    """What the way from one character to the reference body needs to know of the character; the same for all its
    motions.

    Args:
        handles: The character's handles.
        rotations: From its rest pose into the reference body's, shape (K, 3, 3).
        joints: Where its handles meet in its rest pose.
        scale: Length of its strides over the reference body's.
        rise: How much higher its floor is in the rest pose than in the reference body's stance [m].
        lever: From the root's place in that stance to the one in the rest pose [m], shape (3,).
    """

    handles: Handles
    rotations: np.ndarray
    joints: Joints
    scale: float
    rise: float
    lever: np.ndarray

    @classmethod
    def of(cls, character: Character, handles: Handles, rest: tuple[np.ndarray, Joints] | None = None) -> WayBack:
        """Measure a character as `fit_motion` does.

        Args:
            character: Facing +Z, in the pose that its motions are relative to.
            handles: Its handles, K = 30 with the reference body's meaning.
            rest: What a rig tells of the rest pose (see `fit_motion`); None measures it.
        """
        character, handles = decimated(character, handles)
        rotations, joints = rest or rest_to_reference(character, handles)
        stance, there = stance_of(character, handles, joints, rotations)
        stands = standing(stance, there)
        rise = float(character.vertices[stands, 1].min()) - float(stance.vertices[stands, 1].min())
        lever = handles.positions[0].astype(np.float64) - there.positions[0]
        return cls(handles, rotations, joints, stride_scale(stance, there, stands), rise, lever)

    def motion(self, motion: HandleMotion, native: bool = True) -> HandleMotion:
        """A handle motion of the character as the one of the reference body that `fit_motion` of a `native` motion
        without its ground stages takes back to the character's.

        Limbs turn back from the character's rest directions, parts that the character lacks move with their parents,
        and what its parts do beyond stiff joints is carried over in the reference's scale. Of several limbs that play
        one part, the first speaks for all. The root's path keeps its height over the floor that the character's rest
        pose stands on.

        Args:
            motion: Of the character's handles.
            native: It stays one of this very body. Otherwise it becomes a person's: parts stay closer to their joints,
                there is no tail, and the reference body stands on y = 0.
        """
        known = reference_joints()
        parents, present = reference_parts(self.handles, self.joints)
        rotations = motion.rotations.astype(np.float64) @ self.rotations.transpose(0, 2, 1)
        stiff = attach_joints(motion.rotations.astype(np.float64), self.handles, self.joints)[1]
        residual = (motion.translations - stiff) / self.scale * present[:, None]
        residual[:, 0] = 0
        for handle in downwards(HANDLE_PARENTS):
            if not present[handle] and handle:
                rotations[:, handle] = rotations[:, max(int(parents[handle]), 0)]
        translations = attach_joints(rotations, reference_body().handles, known)[1] + capped(residual, native)
        path = motion.root_translation - np.array([0, self.rise, 0]) - (motion.root_rotation - np.eye(3)) @ self.lever
        result = replace(motion, rotations=rotations, translations=translations, root_translation=path / self.scale)
        return result if native else _as_person(result)


def motion_to_reference(
    motion: HandleMotion, character: Character, handles: Handles, native: bool = False
) -> HandleMotion:
    """A handle motion of a character as one of the reference body.

    Args:
        motion: Motion of the character's handles.
        character: The character, facing +Z, in the pose that the motion is relative to.
        handles: Its handles, K = 30 with the reference body's meaning.
        native: The motion stays one of this very body; otherwise it becomes a person's (see `WayBack.motion`).

    Returns:
        The motion of the reference body's handles.
    """
    return WayBack.of(character, handles).motion(motion, native)


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
