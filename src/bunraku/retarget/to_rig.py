"""From the reference body to a character's own rig.

The rig is fitted as 30 handles whose joints are the heads of its bones, by the stages of `fit_motion`; then each bone
takes the turn of its part. Bones that no part of the reference body moves keep their rest pose on their parents. Bones
keep their lengths: only the pelvis travels. Bones of MMD models that take over other bones' turns, or follow them by
inverse kinematics (sleeves), are then posed as MMD does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.retarget.body_motion import stiff
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.mmd.pose import pose_mmd
from bunraku.retarget.rig_parts import RigParts
from bunraku.skeletons.bone_names import NO_HANDLE

__all__ = ["fit_rig", "on_bones"]


def fit_rig(
    motion: HandleMotion,
    character: Character | RigParts,
    stages: Stages | None = None,
    heights: np.ndarray | None = None,
) -> RigAnimation:
    """A handle motion of the reference body on the rig of a character.

    Args:
        motion: Motion of the reference body's handles, feet on y = 0.
        character: The character, facing +Z, or its `RigParts`.
        stages: Which stages run; all when None. `shape` never does: bones keep their lengths.
        heights: See `fit_motion`.

    Raises:
        CharacterError: There is no rig, or its bones' names do not tell which parts they move.
    """
    parts = character if isinstance(character, RigParts) else RigParts.of(character)
    fitted = fit_motion(
        stiff(motion),
        parts.anatomy,
        replace(stages or Stages(), shape=False),
        heights,
    )
    return on_bones(parts, fitted, motion)


def on_bones(parts: RigParts, fitted: HandleMotion, reference: HandleMotion | None = None) -> RigAnimation:
    """The bones of a rig as its 30 handles move.

    Args:
        parts: The rig.
        fitted: Motion of `parts.handles`.
        reference: The motion of the reference body that it was fitted from.
    """
    rotations, positions = parts.world(fitted.transforms(parts.handles.positions).astype(np.float64))
    return _with_helpers(RigAnimation.of_world(parts.character, rotations, positions, fitted.fps, reference), parts)


def _with_helpers(animation: RigAnimation, parts: RigParts) -> RigAnimation:
    """The animation with the helper bones of an MMD model in their places; legs and arms stay as they are, without
    inverse kinematics.
    """
    model, rig = mmd_model(parts.character), parts.character.rig
    if (
        model is None
        or rig is None
        or len(model.bones) != len(rig.names)
        or not np.allclose(model.positions, rig.positions, atol=1e-4)
    ):
        return animation
    tracks, switches = {}, {}
    for bone, entry in enumerate(model.bones):
        if entry.append is None and model.bone(entry.name) == bone:  # of equal names the first counts
            tracks[entry.name] = animation.translations[:, bone], animation.rotations[:, bone]
        if entry.ik is not None:
            moved = [entry.ik.target, *(link.bone for link in entry.ik.links)]
            switches[entry.name] = np.full(len(animation), bool((parts.parts[moved] == NO_HANDLE).all()))
    poses = pose_mmd(model, tracks, switches, frames=len(animation), fps=animation.fps)
    return RigAnimation.of_world(parts.character, poses.rotations, poses.positions, animation.fps, animation.reference)
