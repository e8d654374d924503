"""A VMD on the skeleton of an MMD model: poses, vertices, and the motion of SMPL's 22 joints that any other character
can take.
"""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdModel, mmd_model
from bunraku.core.motion import SkeletalMotion, Skeleton, line_up, local_rotations
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import MotionError
from bunraku.formats.mmd.vmd import VMD_FPS, VmdMotion
from bunraku.retarget.mmd.pose import MmdPoses, pose_mmd
from bunraku.skeletons.joint_map import SkeletonMap
from bunraku.skeletons.mmd_names import mmd_skeleton_map
from bunraku.skeletons.to_smpl import to_smpl

__all__ = ["mmd_animation", "mmd_poses_to_smpl", "model_of", "play_vmd", "standard_bones"]

MOST_TRANSFORMS = 20_000_000  # of all bones in all frames: 1 GB


def model_of(target: Character | MmdModel) -> MmdModel:
    """The MMD model of a character.

    Raises:
        MotionError: It was not read from a PMX or PMD file.
    """
    model = target if isinstance(target, MmdModel) else mmd_model(target)
    if model is None:
        raise MotionError(f"{target.name}: this character is no MMD model; load one from a PMX or PMD file")
    return model


def standard_bones(model: MmdModel) -> SkeletonMap:
    """Which bones of a model are which of SMPL's 22 joints.

    Raises:
        MotionError: The bones do not have MMD's standard names.
    """
    found = mmd_skeleton_map(model.names)
    if found is None:
        raise MotionError(
            f"{model.name or 'this model'}: its bones do not have MMD's standard names (下半身, 左足, 左ひざ ...)"
        )
    return found


def play_vmd(target: Character | MmdModel, vmd: VmdMotion, fps: float = VMD_FPS, *, ik: bool | None = None) -> MmdPoses:
    """Pose an MMD model by a VMD.

    Args:
        target: The model, or the character that was read from it.
        vmd: The motion; bones that the model lacks are passed over.
        fps: Frames a second [1/s].
        ik: Whether inverse kinematics are solved; None does as the file's switches say.

    Raises:
        MotionError: The character is no MMD model, none of its bones has keys, or there are too many frames.
    """
    model = model_of(target)
    own = {_cut(name, 15): name for name in reversed(model.names)}
    if not own.keys() & vmd.bones.keys():
        raise MotionError(
            f"the motion moves none of the {len(model.bones)} bones of {model.name or 'this model'}; take one that "
            "was made for MMD's standard bones"
        )
    count = vmd.frame_count(fps)
    if count * len(model.bones) > MOST_TRANSFORMS:
        raise MotionError(
            f"the motion has {count:,} frames for {len(model.bones):,} bones, too many; cut it or ask for fewer "
            "frames a second"
        )
    tracks = {own[name]: track for name, track in vmd.sample(fps, own).items()}
    frames = np.arange(count) * (VMD_FPS / fps)
    goals = [bone.name for bone in model.bones if bone.ik is not None]
    if ik is None:
        on = {name: _switched(vmd, _cut(name, 20), frames) for name in goals}
    else:
        on = {name: np.full(count, ik) for name in goals}
    return pose_mmd(model, tracks, on, frames=count, fps=fps)


def mmd_animation(character: Character, vmd: VmdMotion, fps: float = VMD_FPS) -> RigAnimation:
    """A VMD on the character that was read from the model, as an animation of its own rig; arguments and errors are
    those of `play_vmd`.
    """
    poses = play_vmd(character, vmd, fps)
    return RigAnimation.of_world(character, poses.rotations, poses.positions, fps)


def _cut(name: str, size: int) -> str:
    """A name as VMD holds it."""
    return name.encode("cp932", "ignore")[:size].decode("cp932", "ignore")


def _switched(vmd: VmdMotion, name: str, frames: np.ndarray) -> np.ndarray:
    """Whether the inverse kinematics of a bone are on at frames of 30 a second."""
    out = np.ones(len(frames), bool)
    for start, states in vmd.switches:
        if name in states:
            out[frames >= start] = states[name]
    return out


def mmd_poses_to_smpl(poses: MmdPoses) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that moves as an MMD model does, inverse kinematics and all.

    Raises:
        MotionError: The bones do not have MMD's standard names.
    """
    found = standard_bones(poses.model)
    parents = poses.model.parents
    lines = {joint: line_up(joint, parents) for joint in found.joints if joint >= 0}
    shared = set.intersection(*(set(line) for line in lines.values()))
    root = next((bone for bone in next(iter(lines.values())) if bone in shared), -1)
    if root < 0:
        raise MotionError(f"{poses.model.name or 'this model'}: its legs and arms do not hang on one bone")
    chosen = sorted(
        {bone for line in lines.values() for bone in line[: line.index(root) + 1]},
        key=lambda bone: (len(line_up(bone, parents)), bone),
    )
    index = {bone: number for number, bone in enumerate(chosen)}
    above = np.array([index.get(int(parents[bone]), -1) if bone != root else -1 for bone in chosen])
    rest = poses.model.positions[chosen]
    offsets = rest - np.where(above[:, None] >= 0, rest[above], 0)
    local = local_rotations(poses.rotations[:, chosen].astype(float), above)
    skeleton = Skeleton(tuple(poses.model.names[bone] for bone in chosen), above, offsets)
    motion = SkeletalMotion(skeleton, local, poses.positions[:, root], poses.fps)
    joints = tuple(index[joint] if joint >= 0 else -1 for joint in found.joints)
    return to_smpl(motion, SkeletonMap(joints, found.how, found.convention))
