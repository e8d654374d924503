"""Motions written for humanoids, in the character's own proportions: BVH, VRMA, VMD, and NPZ of the reference body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.avatars import MmdModel
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import HANDLE_COUNT, JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.files import VMD_FPS, check_writer, write_vmd

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy

Humanoid = HandleMotion | SkeletalMotion | Animation
"""What has a humanoid skeleton: a motion of the reference body or of a skeleton, or an animation of a character."""


def as_skeletal(given: Humanoid) -> SkeletalMotion:
    """A motion of a skeleton: the given one, that of the reference body's 22 joints, or `humanoid_motion`; MotionError
    where A handle motion has too few handles.
    """
    if isinstance(given, Animation):
        return humanoid_motion(given)
    return skeleton_from_handles(given) if isinstance(given, HandleMotion) else given


def write_humanoid_bvh(
    given: Humanoid, path: Path, *, fps: float | None = None, unit: str = "cm", up: str = "+y", order: str = "zxy"
) -> Path:
    """Write the humanoid skeleton of a motion or an animation as BVH; see `write_bvh`."""
    from bunraku.core.motion import checked_fps
    from bunraku.files import write_bvh

    skeletal = as_skeletal(given)
    return write_bvh(skeletal, path, fps=checked_fps(fps, skeletal.fps), unit=unit, up=up, order=order)


def write_humanoid_vrma(given: Humanoid, path: Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write the humanoid skeleton of a motion or an animation as VRMA; see `write_vrma`."""
    from bunraku.anatomy.names.to_smpl import to_smpl
    from bunraku.files import write_vrma

    skeletal = as_skeletal(given)
    if len(skeletal) and skeletal.skeleton.names != JOINT_NAMES:
        skeletal = to_smpl(skeletal)
    return write_vrma(skeletal, path, fps=fps, name=name)


def write_motion_npz(motion: HandleMotion | SkeletalMotion, path: Path) -> Path:
    """Write a handle motion of the reference body as NPZ; OptionError where the motion is of a skeleton."""
    from bunraku.core.files import atomic_write
    from bunraku.files import pack_motion

    if not isinstance(motion, HandleMotion):
        raise OptionError("an .npz holds handle motion, and this motion is of a skeleton; write it as .bvh or .vrma")
    with atomic_write(path) as file:
        file.write(pack_motion(motion, reference_body().handles))
    return path


def humanoid_motion(animation: Animation) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that an animation plays, with the character's bone lengths and path.

    Parts that the character lacks have the reference body's bones in its scale. Of several limbs of one kind the first
    counts.

    Raises:
        MotionError: The animation's handles are not the 30 of the reference body.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.anatomy.joints import reference_parts
    from bunraku.retarget.to_reference import motion_to_reference

    if len(animation.handles.positions) != HANDLE_COUNT:
        raise MotionError(
            f"a humanoid skeleton is found from the {HANDLE_COUNT} handles of Bunraku, and this animation has "
            f"{len(animation.handles.positions)}; animate the character with `bunraku animate`"
        )
    anatomy = Anatomy.of(animation.character, animation.handles)
    plain = skeleton_from_handles(motion_to_reference(animation.motion, anatomy))
    _, present = reference_parts(anatomy.handles, anatomy.joints)
    pelvis = _pelvis(anatomy, present)
    root = animation.motion.transforms(animation.handles.positions)[:, 0].astype(float)
    skeleton = Skeleton(JOINT_NAMES, np.array(JOINT_PARENTS), _offsets(anatomy, pelvis))
    return SkeletalMotion(skeleton, plain.rotations, root[..., :3] @ pelvis + root[..., 3], plain.fps)


def _offsets(anatomy: Anatomy, pelvis: np.ndarray) -> np.ndarray:
    """Rest offsets in the T-pose [m], shape (22, 3): those between the character's joints, rotated as its limbs are.

    Missing joints in the middle of a limb share the length between their neighbours as the reference body's do.
    """
    from bunraku.anatomy.joints import reference_parts

    body = reference_body()
    plain = body.skeleton.offsets.astype(float)
    parents, present = reference_parts(anatomy.handles, anatomy.joints)
    joints = anatomy.joints.positions[:JOINT_COUNT].astype(float)
    joints[0] = pelvis
    out = plain * anatomy.scale
    for joint in range(1, JOINT_COUNT):
        if not present[joint]:
            continue
        above = int(parents[joint])
        line = [joint]
        while JOINT_PARENTS[line[-1]] != above:
            line.append(JOINT_PARENTS[line[-1]])
        offset = anatomy.rotations[above] @ (joints[joint] - joints[above])
        todo = [member for member in line if member == joint or not _shared(member, joint, parents, present)]
        offset = offset - sum((out[member] for member in line if member not in todo), np.zeros(3))
        lengths = np.linalg.norm(plain[todo], axis=-1)
        for member, length in zip(todo, lengths, strict=True):
            out[member] = offset * length / lengths.sum()
    out[0] = 0
    return out


def _shared(joint: int, lower: int, parents: np.ndarray, present: np.ndarray) -> bool:
    """Whether a missing joint already has an offset, from an earlier joint that is present."""
    for other in range(1, lower):
        if present[other]:
            line = other
            while line != int(parents[other]):
                if line == joint:
                    return True
                line = JOINT_PARENTS[line]
    return False


def _pelvis(anatomy: Anatomy, present: np.ndarray) -> np.ndarray:
    """The pelvis joint at rest [m], shape (3,): as the reference body's lies to its hips, or to its root handle."""
    body, joints = reference_body(), anatomy.joints.positions
    if present[1] and present[2]:
        size = np.linalg.norm(joints[1] - joints[2]) / np.linalg.norm(body.joints[1] - body.joints[2])
        return np.asarray((joints[1] + joints[2]) / 2 - size * ((body.joints[1] + body.joints[2]) / 2 - body.joints[0]))
    return np.asarray(anatomy.handles.positions[0] + (body.joints[0] - body.handles.positions[0]) * anatomy.scale)


def write_character_vmd(animation: Animation | RigAnimation, path: Path, *, fps: float | None = None) -> Path:
    """Write what an MMD character does as keys of its bones, at 30 frames a second, with the inverse kinematics of its
    legs off.

    An animation of the character's own bones is written bone by bone, one of its handles as what SMPL's 22 joints do.

    Raises:
        FormatError: The character was not read from a PMX or PMD file, the model has a bone whose name VMD cannot hold,
            or the file cannot be written.
        OptionError: Another rate than 30 is requested, which VMD files have.
        MotionError: The animation is of handles, and the model's bones lack MMD's standard names.
    """
    from bunraku.retarget.mmd_motion import mmd_clip, mmd_motion

    if fps not in (None, VMD_FPS):
        raise OptionError(f"VMD files have 30 frames a second, not {fps:g}; leave fps out, and the motion is resampled")
    character = animation.character
    check_writer(path, mmd=isinstance(character.avatar, MmdModel))
    if isinstance(animation, RigAnimation):
        return write_vmd(mmd_clip(animation), path)
    try:
        motion = humanoid_motion(animation)
    except MotionError as error:
        raise FormatError(path, str(error)) from None
    return write_vmd(mmd_motion(character, motion), path)
