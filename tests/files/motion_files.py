"""Skeletal motions to write into files, and a writer of HumanML3D's vectors after the published description of that
set.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion


def about_y(angle):
    """Turns about +Y by angles [rad], shape (N,) or one number."""
    return Rotation.from_rotvec(np.asarray(angle)[..., None] * [0.0, 1, 0])


def walk_about(frames=60, fps=20.0, seed=0, size=0.3, still=()):
    """A body that walks in a curve while it bends its joints, but those that are `still`, by smooth random angles."""
    rng, time = np.random.default_rng(seed), np.linspace(0, 3, frames)
    bend = np.sin(
        time[:, None, None] * rng.uniform(0.5, 2, (1, JOINT_COUNT, 1)) + rng.uniform(0, 6, (1, JOINT_COUNT, 1))
    )
    rotations = (
        Rotation.from_rotvec((bend * rng.normal(0, size, (1, JOINT_COUNT, 3))).reshape(-1, 3))
        .as_matrix()
        .reshape(frames, JOINT_COUNT, 3, 3)
    )
    rotations[:, [JOINT_NAMES.index(name) for name in still]] = np.eye(3)
    turn = about_y(np.radians(40 * time + 20)).as_matrix()
    rotations[:, 0] = turn @ rotations[:, 0]
    root = np.stack([np.sin(time), 1 + 0.05 * np.cos(5 * time), time - 0.5 * np.cos(time)], -1)
    return SkeletalMotion(reference_body().skeleton, rotations, root, fps)


def humanml3d_vectors(positions):
    """Rows of `new_joint_vecs`, one fewer than there are positions (N + 1, 22, 3)."""
    left_hip, right_hip, left_shoulder, right_shoulder = 1, 2, 16, 17
    across = (
        positions[:, right_hip] - positions[:, left_hip] + positions[:, right_shoulder] - positions[:, left_shoulder]
    )
    forward = np.cross([0, 1, 0], across)
    angle = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    off = about_y(-angle)  # the turn that takes the heading to +Z

    def turned(rotation, vectors):
        return np.stack([r.apply(v) for r, v in zip(rotation, vectors, strict=True)])

    root_step = turned(off[1:], np.diff(positions[:, :1], axis=0))[:, 0]
    ground = positions.copy()
    ground[..., [0, 2]] -= positions[:, :1, [0, 2]]
    local = turned(off, ground)
    step = turned(off[:-1], np.diff(positions, axis=0))
    half_turn = np.arcsin((off[1:] * off[:-1].inv()).as_quat(canonical=True)[:, 1])
    contact = (np.square(np.diff(positions[:, [7, 10, 8, 11]], axis=0)).sum(-1) < 0.002).astype(float)
    frames = len(positions) - 1
    six = np.tile([1.0, 0, 0, 0, 1, 0], (frames, 21))  # by their own inverse kinematics; no reader needs it
    root = [half_turn[:, None], root_step[:, [0, 2]], positions[:-1, 0, 1:2]]
    parts = [*root, local[:-1, 1:].reshape(frames, -1), six, step.reshape(frames, -1), contact]
    return np.concatenate(parts, axis=1).astype(np.float32), angle[0]
