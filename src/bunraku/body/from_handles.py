"""Handle motions of the reference body as motions of SMPL's 22 joints: the way back of
`retarget.from_mesh.handle_motion_of_body`.

A handle's rotation is the rigid motion that fits all the skin that it weighs, and near joints that skin is shared: the
handle of a collar, most of whose skin is the chest's or the arm's too, turns twelve degrees less or more than the
joint. So the joints' rotations are those whose skin, posed and registered, gives the handles' rotations back. The
covariances that registration takes the rotations from are linear in the joints' transforms, so no vertex is posed on
the way: each round is two matrix products and turns every joint by what its handle lacks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, local_rotations
from bunraku.core.skinning import posed_points
from bunraku.errors import MotionError
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, nearest_rotation
from bunraku.geometry.surface import vertex_areas

__all__ = ["joint_errors", "skeleton_from_handles"]

ROUNDS = 12
CHUNK = 1000  # frames at once
_PARENTS = np.array(JOINT_PARENTS)


@dataclass(frozen=True)
class _Moments:
    """What the covariances of handles are made of: handle k has sum_j R_j A_jk + p_j c_jk^T.

    Args:
        linear: A over the joints' axes and the handles' axes, shape (3 J, 3 J).
        shift: c over the joints and the handles' axes, shape (J, 3 J).
    """

    linear: np.ndarray
    shift: np.ndarray


@lru_cache(maxsize=1)
def _moments() -> _Moments:
    body = reference_body()
    vertices, count = body.vertices.astype(float), JOINT_COUNT
    mass = body.handle_weights[:, :count].astype(float) * vertex_areas(body.vertices, body.faces)[:, None]
    mass /= np.maximum(mass.sum(axis=0), 1e-30)
    means = mass.T @ vertices
    arms = (vertices[:, None] - means) * mass[..., None]  # (V, K, 3)
    own = body.joint_weights.astype(float)
    from_joint = own[..., None] * (vertices[:, None] - body.joints)  # (V, J, 3)
    linear = np.einsum("vja,vkb->jakb", from_joint, arms, optimize=True)
    return _Moments(linear.reshape(3 * count, 3 * count), (own.T @ arms.reshape(len(vertices), -1)))


def skeleton_from_handles(motion: HandleMotion, rounds: int = ROUNDS) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that moves the reference body as a handle motion does.

    The skeleton is the reference body's. What handles do beyond turning about joints (soft bending, tails, fingers) is
    left out; `joint_errors` says how much that is.

    Args:
        motion: Of the reference body's handles: at least 22, those of SMPL's joints first.
        rounds: How often the joints are turned by what the handles lack; 0 takes the handles' rotations for the
            joints'.

    Raises:
        MotionError: The motion has fewer handles.
    """
    if motion.rotations.shape[1] < JOINT_COUNT:
        raise MotionError(
            f"a motion of {motion.rotations.shape[1]} handles is not one of the reference body, which has 30; "
            "retarget it first"
        )
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
    """World rotations of the joints (N, 22, 3, 3) under which the handles turn as wanted."""
    moments, world = _moments(), want.copy()
    frames = len(want)
    for _ in range(rounds):
        wide = world.transpose(0, 2, 1, 3).reshape(3 * frames, -1)  # rows: frame and axis; columns: joint and its axis
        positions = _joint_positions(world).transpose(0, 2, 1).reshape(3 * frames, -1)
        covariance = (
            (wide @ moments.linear + positions @ moments.shift).reshape(frames, 3, JOINT_COUNT, 3).transpose(0, 2, 1, 3)
        )
        lacking = axis_angle_from_matrix(want @ np.swapaxes(nearest_rotation(covariance), -1, -2))
        world = matrix_from_axis_angle(lacking) @ world
    return world


def _mean_of_root(world: np.ndarray) -> np.ndarray:
    """Where the mean of the pelvis handle's skin is from the pelvis joint [m], shape (N, 3)."""
    body = reference_body()
    mass = body.handle_weights[:, 0].astype(float) * vertex_areas(body.vertices, body.faces)
    mass /= mass.sum()
    shares = mass[:, None] * body.joint_weights
    arms = np.einsum("vj,vja->ja", shares, body.vertices[:, None].astype(float) - body.joints)
    return np.asarray(
        np.einsum("njab,jb->na", world, arms) + np.einsum("j,nja->na", shares.sum(axis=0), _joint_positions(world))
    )


def joint_errors(motion: HandleMotion, found: SkeletalMotion) -> np.ndarray:
    """How far joints are from where the handles above and below them take them, in the mean over frames [m], shape
    (22,).

    Args:
        motion: Of the reference body's handles.
        found: What `skeleton_from_handles` made of it.
    """
    body = reference_body()
    transforms = motion.transforms(body.handles.positions)[:, :JOINT_COUNT].astype(float)
    own = posed_points(transforms, body.joints)
    above = np.maximum(_PARENTS, 0)
    upper = transforms[:, above]
    other = posed_points(upper, body.joints)
    return np.asarray(np.linalg.norm((own + other) / 2 - found.world()[1], axis=-1).mean(axis=0))
