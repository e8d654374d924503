"""From a character to the reference body: the way back of `fit_motion`, for motions that other characters bring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.bodies.layout import HANDLE_NAMES
from bunraku.bodies.reference import reference_body
from bunraku.character import Character, Handles
from bunraku.geometry.skinning import skin
from bunraku.motion import HandleMotion
from bunraku.retarget.ground import standing, stride_scale
from bunraku.retarget.joints import Joints, attached, reference_joints
from bunraku.retarget.limbs import reference_parts
from bunraku.retarget.neutral import neutral_pose, rest_turns

__all__ = ["motion_to_reference"]


def motion_to_reference(motion: HandleMotion, character: Character, handles: Handles) -> HandleMotion:
    """A handle motion of a character as one of the reference body, standing on y = 0.

    Args:
        motion: Motion of the character's handles.
        character: The character, facing +Z, in the pose that the motion is relative to.
        handles: Its handles, K = 30 with the reference body's meaning.

    Returns:
        The motion of the reference body's handles: limbs turned back from the character's rest directions, handles that the
        character lacks moving with their parents, and the root's path in the reference's scale.
    """
    body, known = reference_body(), reference_joints()
    turns, own = rest_turns(character, handles)
    stance = neutral_pose(character, handles, own, turns)
    rotations = motion.rotations.astype(np.float64) @ turns.transpose(0, 2, 1)
    rotations, translations = attached(rotations, body.handles, Joints(known.positions, *reference_parts(handles, own)))
    tail = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]  # a person has none
    rotations[:, tail], translations[:, tail] = np.eye(3), 0
    path = motion.root_translation / stride_scale(*stance, standing(*stance))
    result = replace(motion, rotations=rotations, translations=translations, root_translation=path)
    lowest = skin(body.vertices, body.handle_weights, result.transforms(body.handles.positions))[..., 1].min(axis=1)
    return replace(result, root_translation=path - np.array([0, np.quantile(lowest, 0.05), 0], np.float32))
