"""Motion of SMPL's 22 joints as handle motion of the reference body, joint by joint.

`retarget.from_mesh.handle_motion_of_body` registers the skinned mesh, which is what networks are trained on; there,
rotations blur where weights do. Here handles take the rotations of their joints as they are, so limbs point where the
source's point.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.ground import reference_reach
from bunraku.anatomy.joints import attach_joints, reference_joints
from bunraku.body.layout import HANDLE_COUNT, HANDLE_PARENTS, JOINT_COUNT, JOINT_NAMES
from bunraku.body.reference import leg_length, reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import MotionError

__all__ = ["body_handle_motion", "stiff"]

STANDS = 0.05  # share of frames whose lowest point may be under the ground


def body_handle_motion(motion: SkeletalMotion) -> HandleMotion:
    """Handle motion of the reference body, which stands on y = 0.

    Args:
        motion: Of SMPL's 22 joints, relative to the reference body's T-pose (`bodies.to_smpl`).

    Raises:
        MotionError: It has other joints.
    """
    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("the reference body takes motions of SMPL's 22 joints only; map the skeleton first")
    body, joints = reference_body(), reference_joints()
    world = motion.world()[0].astype(np.float64)
    root = world[:, 0]
    rotations = np.tile(np.eye(3), (len(motion), HANDLE_COUNT, 1, 1))
    rotations[:, 1:JOINT_COUNT] = np.swapaxes(root, -1, -2)[:, None] @ world[:, 1:]
    for handle in range(JOINT_COUNT, HANDLE_COUNT):
        rotations[:, handle] = rotations[:, HANDLE_PARENTS[handle]]
    rotations, translations = attach_joints(rotations, body.handles, joints)
    scale = leg_length(body.joints) / max(leg_length(motion.skeleton.positions), 1e-9)
    pelvis, position = body.joints[0].astype(np.float64), body.handles.positions[0].astype(np.float64)
    path = motion.root_translation * scale + np.einsum("nij,j->ni", root, position - pelvis) - position
    out = HandleMotion(translations, rotations, path, root, motion.fps)
    path[:, 1] -= np.quantile(reference_reach().lowest(out, body.handles.positions), STANDS)
    return replace(out, root_translation=path)


def stiff(motion: HandleMotion) -> HandleMotion:
    """A motion of the reference body with all joints held, as bones hold them."""
    rotations, translations = attach_joints(
        motion.rotations.astype(np.float64), reference_body().handles, reference_joints()
    )
    return replace(motion, rotations=rotations, translations=translations)
