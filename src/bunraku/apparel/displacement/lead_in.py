"""The way from the rest pose into the first frame of a clip, for the 22 joints alone: what apparel hangs in before it
begins.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.geometry.rotations import matrix_from_quaternion, matrix_y, quaternion_from_matrix, quaternion_slerp

__all__ = ["lead_in_transforms", "rest_transforms"]

BLEND = 0.6  # share of the way in which the pose changes; in the rest of it apparel settles


def rest_transforms(joints: np.ndarray, first: np.ndarray) -> np.ndarray:
    """`[R | t]` of the rest pose, standing where a frame does and looking where it looks, shape (22, 3, 4).

    Args:
        joints: J [m], shape (22, 3).
        first: The frame, shape (22, 3, 4).
    """
    mean = first[:, :, :3].mean(axis=0)
    yaw = np.asarray(matrix_y(np.array(np.arctan2(mean[0, 2] - mean[2, 0], mean[0, 0] + mean[2, 2]))))
    positions = joints @ yaw.T
    positions = positions + first[:, :, 3].mean(axis=0) - positions.mean(axis=0)
    return np.concatenate([np.broadcast_to(yaw, (JOINT_COUNT, 3, 3)), positions[..., None]], axis=2)


def lead_in_transforms(joints: np.ndarray, first: np.ndarray, frames: int) -> np.ndarray:
    """Frames from the rest pose to the first frame of a clip, shape (frames, 22, 3, 4), float32.

    Args:
        joints: J [m], shape (22, 3).
        first: The first frame, shape (22, 3, 4).
        frames: How many; the pose changes in the first 60 % of them.
    """
    start, end = rest_transforms(joints, first), np.asarray(first, np.float64)
    share = np.clip(np.arange(frames) / max(BLEND * frames, 1), 0, 1)
    share = share * share * (3 - 2 * share)
    parents = np.array(JOINT_PARENTS)
    locals_ = [_local(pose, parents) for pose in (start, end)]
    turns = quaternion_slerp(
        quaternion_from_matrix(locals_[0])[None], quaternion_from_matrix(locals_[1])[None],
        np.broadcast_to(share[:, None], (frames, JOINT_COUNT)),
    )  # fmt: skip
    local = matrix_from_quaternion(turns)
    # bones as in the clip's frame, so that the way ends exactly there
    bones = np.einsum("jba,jb->ja", end[parents, :, :3], end[:, :, 3] - end[parents, :, 3])
    rest_bones = joints - joints[parents]
    world, positions = np.array(local), np.zeros((frames, JOINT_COUNT, 3))
    positions[:, 0] = start[0, :, 3] + share[:, None] * (end[0, :, 3] - start[0, :, 3])
    for joint in range(1, JOINT_COUNT):
        parent = parents[joint]
        world[:, joint] = world[:, parent] @ local[:, joint]
        bone = rest_bones[joint] + share[:, None] * (bones[joint] - rest_bones[joint])
        positions[:, joint] = positions[:, parent] + np.einsum("nab,nb->na", world[:, parent], bone)
    return np.concatenate([world, positions[..., None]], axis=3).astype(np.float32)


def _local(pose: np.ndarray, parents: np.ndarray) -> np.ndarray:
    turns = np.asarray(pose[:, :, :3], np.float64)
    local = np.swapaxes(turns[parents], 1, 2) @ turns
    local[0] = turns[0]
    return np.asarray(local)
