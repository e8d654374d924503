"""From the reference body to a character's own rig, and clips copied between characters with the same skeleton."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.anatomy.names.bone_names import NO_HANDLE
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.mmd_pose import pose_mmd
from bunraku.retarget.rig_parts import RigParts, mmd_rig


def stiff(motion: HandleMotion) -> HandleMotion:
    """A motion of the reference body with all joints held, as bones hold them."""
    rotations, translations = reference_anatomy().attached(motion.rotations.astype(np.float64))
    return replace(motion, rotations=rotations, translations=translations)


def fit_rig(
    motion: HandleMotion, character: Character | RigParts, stages: Stages | None = None,
    heights: np.ndarray | None = None,
) -> RigAnimation:  # fmt: skip
    """A handle motion of the reference body, feet on y = 0, on the rig of a character that faces +Z. The stages are
    those of `fit_motion`, but `shape`: bones keep their lengths.

    Raises:
        CharacterError: There is no rig, or its bones' names do not tell which parts they move.
    """
    parts = character if isinstance(character, RigParts) else RigParts.of(character)
    fitted = fit_motion(stiff(motion), parts.anatomy, replace(stages or Stages(), shape=False), heights)
    return on_bones(parts, fitted, motion)


def on_bones(parts: RigParts, fitted: HandleMotion, reference: HandleMotion | None = None) -> RigAnimation:
    """The bones of a rig as its 30 handles move, in a motion that was fitted from one of the reference body."""
    rotations, positions = parts.world(fitted.transforms(parts.handles.positions).astype(np.float64))
    positions = positions + np.where(parts.still[:, None], 0, parts.rise)
    moved = RigAnimation.of_world(parts.character, rotations, positions, fitted.fps, reference)
    return replace(_with_helpers(moved, parts), parts=parts)


def _with_helpers(animation: RigAnimation, parts: RigParts) -> RigAnimation:
    """The animation with an MMD model's helper bones in place; legs and arms stay, without inverse kinematics."""
    model, rig = mmd_rig(parts.character), parts.character.rig
    if model is None or rig is None or not np.allclose(model.positions, rig.positions, atol=1e-4):
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


ALIKE, MOST = 5.0, 20.0
"""How much the rest directions of bones of one skeleton differ in the mean, and at the most [degrees]."""


def copied_bones(
    source: Character, world_rotations: np.ndarray, positions: np.ndarray, fps: float, character: Character
) -> RigAnimation | None:
    """The clip of a character on another one of the same skeleton, or None where it is another skeleton. World
    rotations (N, J, 3, 3) of the bones are from the rest pose, and their heads are at `positions` (N, J, 3) [m].

    Skeletons are the same when every bone that moves a vertex of the character is there by name, below the same bone,
    and rests in the same direction. Bones keep their rotations against their parents; what moves them off their
    positions is scaled by the size of the skeleton.
    """
    if source.rig is None or character.rig is None:
        return None
    theirs, ours = source.rig, character.rig
    indices = {name: bone for bone, name in enumerate(theirs.names)}
    partner = np.array([indices.get(name, -1) for name in ours.names])
    used = np.unique(ours.indices[ours.weights > 0])
    needed = set(used.tolist())
    for bone in used.tolist():
        while ours.parents[bone] >= 0 and int(ours.parents[bone]) not in needed:
            bone = int(ours.parents[bone])
            needed.add(bone)
    ratios, angles = [], []
    for bone in needed:
        above = int(ours.parents[bone])
        if partner[bone] < 0 or (above >= 0) != (theirs.parents[partner[bone]] >= 0):
            return None
        if above < 0:
            continue
        if partner[above] != theirs.parents[partner[bone]]:
            return None
        mine = ours.positions[bone] - ours.positions[above]
        other = theirs.positions[partner[bone]] - theirs.positions[partner[above]]
        lengths = np.linalg.norm(mine), np.linalg.norm(other)
        if min(lengths) > 1e-3 * character.height * min(1.0, source.height / character.height):
            ratios.append(lengths[0] / lengths[1])
            angles.append(np.degrees(np.arccos(np.clip(mine @ other / (lengths[0] * lengths[1]), -1, 1))))
    if len(ratios) < 2 or float(np.mean(angles)) > ALIKE or float(np.max(angles)) > MOST:
        return None
    local = RigAnimation.of_world(source, world_rotations, positions, fps)
    rotations = np.tile(np.eye(3, dtype=np.float32), (len(world_rotations), len(ours.names), 1, 1))
    translations = np.zeros((len(world_rotations), len(ours.names), 3), np.float32)
    there = partner >= 0
    rotations[:, there] = local.rotations[:, partner[there]]
    translations[:, there] = local.translations[:, partner[there]] * float(np.median(ratios))
    return RigAnimation(character, rotations, translations, fps)
