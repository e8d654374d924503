"""Joint rotations from joint positions: what sets of positions only (HumanML3D) leave out.

Positions say where each bone points, not how it is rolled about itself. Parts with several joints (pelvis, chest) are
turned by the rigid transform that fits them, others by the smallest turn from their parent that points them right;
upper arms and thighs are then rolled so that elbows and knees bend the way they can, as far as they are bent.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.body.smpl_rest import LIMB_CHILD, smpl_offsets
from bunraku.core.motion import SkeletalMotion, Skeleton, local_rotations
from bunraku.errors import MotionError
from bunraku.geometry.filters import gaussian
from bunraku.geometry.rotations import matrix_from_axis_angle, nearest_rotation, rotation_between

__all__ = ["motion_from_positions"]

_CHILDREN = [[child for child in range(JOINT_COUNT) if JOINT_PARENTS[child] == joint] for joint in range(JOINT_COUNT)]
_PARTS = ((1, 2, 3), (13, 14, 12))  # left, right and upper joint of the pelvis and of the chest
_PULL = 0.12  # how much an unrolled limb counts against the bend of its hinge, whose sine is at most 1
_SMOOTH = 0.1  # deviation of the mean over time that rolls are taken from [s]


def motion_from_positions(positions: np.ndarray, fps: float) -> SkeletalMotion:
    """Skeletal motion through joint positions of SMPL's 22 joints.

    The bones have the mean length that they have in the positions, and the reference body's directions in the T-pose.

    Args:
        positions: Positions, +Y up [m], shape (N, 22, 3).
        fps: Frames a second [1/s].

    Raises:
        MotionError: The shape is another one, there is no frame, or a value is not finite.
    """
    joints = np.asarray(positions, float)
    if joints.ndim != 3 or joints.shape[1:] != (JOINT_COUNT, 3) or not len(joints):
        raise MotionError(f"joint positions must have shape (frames, {JOINT_COUNT}, 3), not {joints.shape}")
    if not np.isfinite(joints).all():
        raise MotionError("joint positions hold values that are not numbers")
    bones = joints - joints[:, [max(parent, 0) for parent in JOINT_PARENTS]]
    offsets = _rest_offsets(bones)
    world = np.tile(np.eye(3), (len(joints), JOINT_COUNT, 1, 1))
    for joint, children in enumerate(_CHILDREN):
        parent = JOINT_PARENTS[joint]
        above = world[:, max(parent, 0)]
        if len(children) > 1:
            world[:, joint] = _fit(offsets[children], bones[:, children])
        elif children:
            pointing = np.einsum("nji,nj->ni", above, bones[:, children[0]])
            world[:, joint] = above @ rotation_between(offsets[children[0]], pointing)
            if joint in LIMB_CHILD and LIMB_CHILD[joint] in LIMB_CHILD:
                world[:, joint] = _rolled(world[:, joint], joint, offsets, bones, fps)
        else:
            world[:, joint] = above
    parents = np.array(JOINT_PARENTS)
    return SkeletalMotion(Skeleton(JOINT_NAMES, parents, offsets), local_rotations(world, parents), joints[:, 0], fps)


def _rest_offsets(bones: np.ndarray) -> np.ndarray:
    """Offsets in the T-pose [m], shape (22, 3), from bones in all frames (N, 22, 3)."""
    lengths = np.linalg.norm(bones, axis=-1).mean(axis=0)
    directions = smpl_offsets().copy()
    for child in LIMB_CHILD.values():
        directions[child] = reference_body().skeleton.offsets[child]
    out = directions * (lengths / np.maximum(np.linalg.norm(directions, axis=-1), 1e-9))[:, None]
    for left, right, above in _PARTS:  # several joints of one part have an arrangement of their own
        turn = _frame(bones, left, right, above) @ _frame(out, left, right, above).T
        part = [left, right, above]
        out[part] = np.einsum("nji,ncj->nci", turn, bones[:, part]).mean(axis=0)
    out[0] = 0
    return out


def _frame(bones: np.ndarray, left: int, right: int, above: int) -> np.ndarray:
    """Axes of a part as columns: to its left, up along it, forward; shape (..., 3, 3) from bones (..., 22, 3)."""
    across = bones[..., left, :] - bones[..., right, :]
    low = (
        (bones[..., left, :] + bones[..., right, :]) / 2 if left == _PARTS[0][0] else 0
    )  # collar bones may be over the neck's end
    forward = np.cross(across, bones[..., above, :] - low)
    axes = [across, np.cross(forward, across), forward]
    return np.stack([axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12) for axis in axes], -1)


def _fit(rest: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) that bring vectors (C, 3) nearest to moved ones (N, C, 3) (Kabsch 1976)."""
    return nearest_rotation(np.einsum("nci,cj->nij", moved, rest))


def _rolled(world: np.ndarray, joint: int, offsets: np.ndarray, bones: np.ndarray, fps: float) -> np.ndarray:
    """A limb rolled about itself so that the next one bends about its hinge: elbows forward, knees backward."""
    child = LIMB_CHILD[joint]
    axis = offsets[child] / max(float(np.linalg.norm(offsets[child])), 1e-9)
    direction = np.array([0.0, 0, 1]) if "shoulder" in JOINT_NAMES[joint] else np.array([0.0, 0, -1])
    direction -= axis * (axis @ direction)
    bent = np.einsum("nji,nj->ni", world, bones[:, LIMB_CHILD[child]])
    bent /= np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-9)
    pair = np.stack(
        [bent @ direction + _PULL, bent @ np.cross(axis, direction)], -1
    )  # the direction that the roll should turn `way` to
    pair = gaussian(pair, _SMOOTH * fps)
    return np.asarray(world @ matrix_from_axis_angle(np.arctan2(pair[:, 1], pair[:, 0])[:, None] * axis))
