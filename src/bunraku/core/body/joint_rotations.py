"""Rotations of SMPL's 22 joints, from handle motions of the reference body or from positions alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import LIMB_CHILD, reference_body, smpl_offsets
from bunraku.core.geometry.curves import gaussian
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_axis_angle,
    nearest_rotation,
    rotation_between,
)
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, local_rotations
from bunraku.errors import MotionError

ROUNDS = 12
CHUNK = 1000  # frames at once
_PARENTS = np.array(JOINT_PARENTS)


@dataclass(frozen=True)
class _Moments:
    """The parts of the handles' covariances: handle k has sum_j R_j A_jk + p_j c_jk^T."""

    linear: np.ndarray  # A over the joints' axes and the handles' axes, shape (3 J, 3 J)
    shift: np.ndarray  # c over the joints and the handles' axes, shape (J, 3 J)


@lru_cache(maxsize=1)
def _moments() -> _Moments:
    body = reference_body()
    vertices, count = body.vertices.astype(float), JOINT_COUNT
    mass = body.handle_weights[:, :count].astype(float) * vertex_areas(body.vertices, body.faces)[:, None]
    mass /= np.maximum(mass.sum(axis=0), 1e-30)
    means = mass.T @ vertices
    arms = (vertices[:, None] - means) * mass[..., None]  # (V, K, 3)
    joint_weights = body.joint_weights.astype(float)
    from_joint = joint_weights[..., None] * (vertices[:, None] - body.joints)  # (V, J, 3)
    linear = np.einsum("vja,vkb->jakb", from_joint, arms, optimize=True)
    return _Moments(linear.reshape(3 * count, 3 * count), (joint_weights.T @ arms.reshape(len(vertices), -1)))


def skeleton_from_handles(motion: HandleMotion, rounds: int = ROUNDS) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that moves the reference body as a motion of its handles does: at least 22, those
    of SMPL's joints first.

    The skeleton is the reference body's. Joints are rotated by what the handles lack, `rounds` times; 0 takes the
    handles' rotations for theirs. What handles do beyond rotating about joints (soft bending, tails, fingers) is left
    out. MotionError if the motion has fewer handles.
    """
    if motion.rotations.shape[1] < JOINT_COUNT:
        count = motion.rotations.shape[1]
        raise MotionError(f"a motion of {count} handles is not one of the reference body; retarget it first")
    body = reference_body()
    want = motion.root_rotation[:, None].astype(float) @ motion.rotations[:, :JOINT_COUNT]
    world = np.concatenate([_world(want[start : start + CHUNK], rounds) for start in range(0, len(want), CHUNK)])
    # The position of the pelvis handle is a mean of skin, to which the thighs belong too: the root joint is where that
    # mean comes out right.
    root = motion.root_translation + body.handles.positions[0] - _mean_of_root(world)
    return SkeletalMotion(
        Skeleton(JOINT_NAMES, _PARENTS, body.skeleton.offsets), local_rotations(world, _PARENTS), root, motion.fps
    )


def _joint_positions(world: np.ndarray) -> np.ndarray:
    """Joints relative to the pelvis joint [m], shape (N, 22, 3)."""
    offsets = reference_body().skeleton.offsets.astype(float)
    positions = np.zeros((len(world), JOINT_COUNT, 3))
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        positions[:, joint] = positions[:, parent] + world[:, parent] @ offsets[joint]
    return positions


def _world(want: np.ndarray, rounds: int) -> np.ndarray:
    """World rotations of the joints (N, 22, 3, 3) under which the handles rotate as wanted."""
    moments, world = _moments(), want.copy()
    frames = len(want)
    for _ in range(rounds):
        wide = world.transpose(0, 2, 1, 3).reshape(3 * frames, -1)  # rows: frame and axis; columns: joint and its axis
        positions = _joint_positions(world).transpose(0, 2, 1).reshape(3 * frames, -1)
        covariance = (wide @ moments.linear + positions @ moments.shift).reshape(frames, 3, JOINT_COUNT, 3)
        covariance = covariance.transpose(0, 2, 1, 3)
        lacking = axis_angle_from_matrix(want @ np.swapaxes(nearest_rotation(covariance), -1, -2))
        world = matrix_from_axis_angle(lacking) @ world
    return world


def _mean_of_root(world: np.ndarray) -> np.ndarray:
    """Position of the mean of the pelvis handle's skin, from the pelvis joint [m], shape (N, 3)."""
    body = reference_body()
    mass = body.handle_weights[:, 0].astype(float) * vertex_areas(body.vertices, body.faces)
    mass /= mass.sum()
    shares = mass[:, None] * body.joint_weights
    arms = np.einsum("vj,vja->ja", shares, body.vertices[:, None].astype(float) - body.joints)
    heads = np.einsum("j,nja->na", shares.sum(axis=0), _joint_positions(world))
    return np.asarray(np.einsum("njab,jb->na", world, arms) + heads)


_CHILDREN = [[child for child in range(JOINT_COUNT) if JOINT_PARENTS[child] == joint] for joint in range(JOINT_COUNT)]
_PARTS = ((1, 2, 3), (13, 14, 12))  # left, right and upper joint of the pelvis and of the chest
_PULL = 0.12  # how much an unrolled limb counts against the bend of its hinge, whose sine is at most 1
_SMOOTH = 0.1  # deviation of the mean over time that rolls are taken from [s]


def motion_from_positions(positions: np.ndarray, fps: float) -> SkeletalMotion:
    """Skeletal motion through positions of SMPL's 22 joints, +Y up [m], shape (N, 22, 3), at a rate [1/s]. Bones have
    their mean length in the positions, and the reference body's directions in the T-pose. MotionError if the shape is
    another one, there is no frame, or a value is not finite.
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
            spread = np.einsum("nci,cj->nij", bones[:, children], offsets[children])
            world[:, joint] = nearest_rotation(spread)  # brings the vectors closest (Kabsch 1976)
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
    # Collar bones may be over the neck's end.
    low = (bones[..., left, :] + bones[..., right, :]) / 2 if left == _PARTS[0][0] else 0
    forward = np.cross(across, bones[..., above, :] - low)
    axes = [across, np.cross(forward, across), forward]
    return np.stack([axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12) for axis in axes], -1)


def _rolled(world: np.ndarray, joint: int, offsets: np.ndarray, bones: np.ndarray, fps: float) -> np.ndarray:
    """A limb rolled about itself so that the next one bends about its hinge: elbows forward, knees backward."""
    child = LIMB_CHILD[joint]
    axis = offsets[child] / max(float(np.linalg.norm(offsets[child])), 1e-9)
    direction = np.array([0.0, 0, 1]) if "shoulder" in JOINT_NAMES[joint] else np.array([0.0, 0, -1])
    direction -= axis * (axis @ direction)
    bent = np.einsum("nji,nj->ni", world, bones[:, LIMB_CHILD[child]])
    bent /= np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-9)
    pair = np.stack([bent @ direction + _PULL, bent @ np.cross(axis, direction)], -1)  # where the roll should take it
    pair = gaussian(pair, _SMOOTH * fps)
    return np.asarray(world @ matrix_from_axis_angle(np.arctan2(pair[:, 1], pair[:, 0])[:, None] * axis))
