"""What the humanoid skeleton does in an animation, in the character's own proportions: for BVH and VRMA.

The fitted motion is taken back to the reference body (`retarget/reference.py`), so the skeleton does what is seen, foot
locks and edits included, and its rest pose is the T-pose whatever the character's is. Bones have the lengths between
the character's own joints.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.body.from_handles import skeleton_from_handles
from bunraku.body.layout import HANDLE_COUNT, JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import MotionError
from bunraku.io.skeletal import write_motion_bvh, write_motion_vrma

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy

__all__ = ["humanoid_motion", "write_humanoid_bvh", "write_humanoid_vrma"]


def humanoid_motion(animation: Animation) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that an animation plays, with the character's bone lengths and path.

    Parts that the character lacks have the reference body's bones in its scale. Of several limbs of one kind the first
    counts.

    Raises:
        MotionError: The animation's handles are not the 30 of the reference body.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.anatomy.limbs import reference_parts
    from bunraku.retarget.reference import motion_to_reference

    if len(animation.handles.positions) != HANDLE_COUNT:
        raise MotionError(
            f"the humanoid skeleton is told by the {HANDLE_COUNT} handles of Bunraku, and this animation has "
            f"{len(animation.handles.positions)};"
            " animate the character with `bunraku animate`"
        )
    anatomy = Anatomy.of(animation.character, animation.handles)
    plain = skeleton_from_handles(motion_to_reference(animation.motion, anatomy))
    _, present = reference_parts(anatomy.handles, anatomy.joints)
    pelvis = _pelvis(anatomy, present)
    root = animation.motion.transforms(animation.handles.positions)[:, 0].astype(float)
    skeleton = Skeleton(JOINT_NAMES, np.array(JOINT_PARENTS), _offsets(anatomy, pelvis))
    return SkeletalMotion(skeleton, plain.rotations, root[..., :3] @ pelvis + root[..., 3], plain.fps)


def _offsets(anatomy: Anatomy, pelvis: np.ndarray) -> np.ndarray:
    """Rest offsets in the T-pose [m], shape (22, 3): those between the character's joints, turned as its limbs are
    turned.

    Joints that it lacks in the middle of a limb share the way between those around them as the reference body's do.
    """
    from bunraku.anatomy.limbs import reference_parts

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
        way_there = anatomy.rotations[above] @ (joints[joint] - joints[above])
        todo = [some for some in line if some == joint or not _shared(some, joint, parents, present)]
        way_there = way_there - sum((out[some] for some in line if some not in todo), np.zeros(3))
        lengths = np.linalg.norm(plain[todo], axis=-1)
        for some, length in zip(todo, lengths, strict=True):
            out[some] = way_there * length / lengths.sum()
    out[0] = 0
    return out


def _shared(joint: int, lower: int, parents: np.ndarray, present: np.ndarray) -> bool:
    """Whether a joint that is absent was placed already, on the way to a present joint before this one."""
    for other in range(1, lower):
        if present[other]:
            line = other
            while line != int(parents[other]):
                if line == joint:
                    return True
                line = JOINT_PARENTS[line]
    return False


def _pelvis(anatomy: Anatomy, present: np.ndarray) -> np.ndarray:
    """Where the pelvis joint is in the rest pose [m], shape (3,): as the reference body's is to its hips, or to its
    root handle.
    """
    body, joints = reference_body(), anatomy.joints.positions
    if present[1] and present[2]:
        size = np.linalg.norm(joints[1] - joints[2]) / np.linalg.norm(body.joints[1] - body.joints[2])
        return np.asarray((joints[1] + joints[2]) / 2 - size * ((body.joints[1] + body.joints[2]) / 2 - body.joints[0]))
    return np.asarray(anatomy.handles.positions[0] + (body.joints[0] - body.handles.positions[0]) * anatomy.scale)


def write_humanoid_bvh(
    animation: Animation, path: Path, *, fps: float | None = None, unit: str = "cm", up: str = "+y", order: str = "zxy"
) -> Path:
    """Write the humanoid skeleton of an animation as BVH; see `humanoid_motion` and
    `bunraku.formats.bvh.write.write_bvh`.
    """
    return write_motion_bvh(humanoid_motion(animation), path, fps=fps, unit=unit, up=up, order=order)


def write_humanoid_vrma(animation: Animation, path: Path, *, fps: float | None = None, name: str | None = None) -> Path:
    """Write the humanoid skeleton of an animation as VRMA; see `humanoid_motion` and
    `bunraku.formats.vrm.vrma_write.write_vrma`.
    """
    return write_motion_vrma(humanoid_motion(animation), path, fps=fps, name=name)
