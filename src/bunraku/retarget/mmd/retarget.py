"""Onto the bones of MMD models: the motion of SMPL's 22 joints, and any animation of a model's rig, as keys for a VMD.

A model rests in an A-pose and SMPL in a T-pose. With C the rotations of `rotations_of_rest`, which take the T-pose to
the model's rest pose, a bone's world rotation is `W = W_smpl C^T`, the way back of `to_smpl`. The centre bone carries
the pelvis and the path, so both halves of the trunk start from it; the path is scaled by the ratio of leg lengths.
Inverse kinematics of legs are off, since rotations say it all.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import leg_length, reference_body
from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdModel
from bunraku.core.motion import SkeletalMotion, line_up
from bunraku.core.resample import resample_motion
from bunraku.core.rig_animation import RigAnimation, bone_order
from bunraku.errors import MotionError
from bunraku.formats.mmd.vmd import VMD_FPS
from bunraku.formats.mmd.vmd_write import MmdClip
from bunraku.geometry.resampling import Resampling
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.retarget.mmd.play import model_of, standard_bones
from bunraku.skeletons.bone_words import plain_name
from bunraku.skeletons.joint_map import SkeletonMap
from bunraku.skeletons.mmd_names import MMD_CENTRES, mmd_skeleton_map
from bunraku.skeletons.to_smpl import rotations_of_rest

__all__ = ["mmd_clip", "mmd_motion"]

_J = {name: index for index, name in enumerate(JOINT_NAMES)}
_LEGS = ("left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle")


def mmd_motion(target: Character | MmdModel, motion: SkeletalMotion) -> MmdClip:
    """A motion of SMPL's 22 joints as keys of an MMD model's bones.

    Args:
        target: The model, or the character that was read from it.
        motion: Of SMPL's 22 joints, as `to_smpl` gives it; at any rate.

    Returns:
        Keys at 30 frames a second of the centre and of all bones that play a joint's part.

    Raises:
        MotionError: The character is no MMD model, its bones lack MMD's standard names, or the motion has other joints.
    """
    model = model_of(target)
    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("MMD models take motions of SMPL's 22 joints; use bunraku.skeletons.to_smpl first")
    found = standard_bones(model)
    motion = resample_motion(motion, VMD_FPS)
    wanted, centre = _wanted(model, found, motion)
    parents, rest = model.parents, model.positions
    joint_rotations = np.tile(np.eye(3), (len(motion), len(parents), 1, 1))
    positions = np.broadcast_to(rest, (len(motion), *rest.shape)).copy()
    local: dict[int, np.ndarray] = {}
    for bone in bone_order(parents):
        parent = int(parents[bone])
        above = joint_rotations[:, parent] if parent >= 0 else np.eye(3)
        if bone in wanted:
            local[bone] = np.swapaxes(above, -1, -2) @ wanted[bone]
            joint_rotations[:, bone] = wanted[bone]
        else:
            joint_rotations[:, bone] = above
        if parent >= 0:
            positions[:, bone] = positions[:, parent] + np.einsum(
                "nij,j->ni", joint_rotations[:, parent], rest[bone] - rest[parent]
            )
    hips = [found.of("left_hip"), found.of("right_hip")]
    shift = _hips(model, found, motion) - positions[:, hips].mean(axis=1)
    still = np.zeros_like(shift)
    bones = {model.names[bone]: (shift if bone == centre else still, rotations) for bone, rotations in local.items()}
    return MmdClip(bones, model.name, _leg_goals(model))


def _wanted(model: MmdModel, found: SkeletonMap, motion: SkeletalMotion) -> tuple[dict[int, np.ndarray], int]:
    """World rotation of each bone that plays a part, shape (N, 3, 3), and the bone that carries the body."""
    world = motion.world()[0].astype(float)
    back = np.swapaxes(rotations_of_rest(found, model.positions), -1, -2)
    out = {bone: world[:, joint] @ back[joint] for joint, bone in enumerate(found.joints) if bone >= 0}
    line = line_up(found.of("pelvis"), model.parents)
    named = {plain_name(model.names[bone]): bone for bone in line}
    centre = next((named[name] for name in MMD_CENTRES if name in named), line[-1])
    out[centre] = world[:, 0] @ back[0]
    return out, centre


def _hips(model: MmdModel, found: SkeletonMap, motion: SkeletalMotion) -> np.ndarray:
    """Where the middle of the model's hips shall be [m], shape (N, 3): as far above its ankles' height as the motion's,
    by the legs' ratio.
    """
    hips = motion.world()[1][:, [_J["left_hip"], _J["right_hip"]]].mean(axis=1).astype(float)
    rest = motion.skeleton.positions.astype(float)
    own, known = model.positions, reference_body().joints
    joints = [found.of(name) for name in _LEGS]
    length = float(
        np.mean(
            [
                np.linalg.norm(own[a] - own[b]) + np.linalg.norm(own[b] - own[c])
                for a, b, c in (joints[0::2], joints[1::2])
            ]
        )
    )
    source = leg_length(rest)
    toes = known[[_J["left_foot"], _J["right_foot"]], 1].mean() * source / leg_length(known)
    low = (
        toes - motion.skeleton.offsets[[_J["left_foot"], _J["right_foot"]], 1].mean()
    )  # of the source's ankles above its floor
    ratio = length / max(source, 1e-9)
    return np.asarray(hips * ratio + [0, own[joints[4:6], 1].mean() - low * ratio, 0])


def mmd_clip(animation: RigAnimation) -> MmdClip:
    """An animation of an MMD character's rig as keys of its bones, resampled to 30 frames a second.

    What a bone takes over of another ("grant") is taken off its keys again, since MMD adds it. Bones that stand still
    on their parents have no keys: those of them that take over follow in MMD as the model's maker meant them to.

    Args:
        animation: Of a character that was read from a PMX or PMD file.

    Raises:
        MotionError: The character is no MMD model.
    """
    model = model_of(animation.character)
    rotations, translations = _resampled(animation)
    return MmdClip(_keys(model, rotations, translations), model.name, _leg_goals(model))


def _keys(model: MmdModel, rotations: np.ndarray, translations: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Keys of the bones that move, from how each stands on its parent: rotations (N, B, 3, 3) and translations (N, B,
    3).
    """
    keyed_rotations, keyed_moves = rotations.copy(), translations.copy()
    still = _still(rotations, translations)
    keyed_rotations[:, still], keyed_moves[:, still] = np.eye(3), 0
    taken_rotations: dict[int, np.ndarray] = {}
    taken_moves: dict[int, np.ndarray] = {}
    for bone in model.order:
        append = model.bones[bone].append
        if append is not None and append.rotation:
            source = (
                rotations[:, append.bone]
                if append.local
                else taken_rotations.get(append.bone, keyed_rotations[:, append.bone])
            )
            taken_rotations[bone] = matrix_from_axis_angle(append.ratio * axis_angle_from_matrix(source))
            if not still[bone]:
                keyed_rotations[:, bone] = rotations[:, bone] @ np.swapaxes(taken_rotations[bone], -1, -2)
        if append is not None and append.translation:
            move = (
                translations[:, append.bone]
                if append.local
                else taken_moves.get(append.bone, keyed_moves[:, append.bone])
            )
            taken_moves[bone] = append.ratio * move
            if not still[bone]:
                keyed_moves[:, bone] = translations[:, bone] - taken_moves[bone]
    moving = np.flatnonzero(~_still(keyed_rotations, keyed_moves))
    return {model.names[bone]: (keyed_moves[:, bone], keyed_rotations[:, bone]) for bone in moving}


def _still(rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Bones that stand on their parents as they do at rest, shape (B,), bool."""
    return np.asarray(
        (np.abs(rotations - np.eye(3)).max(axis=(0, 2, 3)) < 1e-5) & (np.abs(translations).max(axis=(0, 2)) < 1e-5)
    )


def _resampled(animation: RigAnimation) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations (N, B, 3, 3) and translations (N, B, 3) at 30 frames a second."""
    rotations, translations = animation.rotations.astype(float), animation.translations.astype(float)
    if abs(animation.fps - VMD_FPS) < 1e-6 or len(animation) == 1:
        return rotations, translations
    between = Resampling.of(len(animation), animation.fps, VMD_FPS)
    return between.rotations(rotations), between.linear(translations)


def _leg_goals(model: MmdModel) -> tuple[str, ...]:
    """Bones whose inverse kinematics turn legs or feet; all that have some where the names do not tell what legs
    are.
    """
    found = mmd_skeleton_map(model.names)
    if found is None:
        return tuple(bone.name for bone in model.bones if bone.ik is not None)
    legs = {found.of(name) for name in _LEGS}
    return tuple(
        bone.name for bone in model.bones if bone.ik is not None and legs & {link.bone for link in bone.ik.links}
    )
