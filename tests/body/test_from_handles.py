"""Handle motions of the reference body back to joints, against the joints that they were made of."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.body.from_handles import joint_errors, skeleton_from_handles
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import MotionError
from bunraku.retarget.from_mesh import handle_motion_of_body


def degrees(a, b):
    """Angles between rotations, by another library."""
    turns = np.swapaxes(a, -1, -2).astype(float) @ b
    return np.degrees(Rotation.from_matrix(turns.reshape(-1, 3, 3)).magnitude()).reshape(turns.shape[:-2])


@pytest.fixture(scope="module")
def motion():
    """A body that turns about and bends all its joints."""
    rng, time = np.random.default_rng(3), np.linspace(0, 3, 24)
    bend = np.sin(
        time[:, None, None] * rng.uniform(0.5, 2, (1, JOINT_COUNT, 1)) + rng.uniform(0, 6, (1, JOINT_COUNT, 1))
    )
    turns = (
        Rotation.from_rotvec((bend * rng.normal(0, 0.25, (1, JOINT_COUNT, 3))).reshape(-1, 3))
        .as_matrix()
        .reshape(-1, JOINT_COUNT, 3, 3)
    )
    turns[:, 0] = Rotation.from_rotvec(time[:, None] * [0.1, 1.5, 0.2]).as_matrix()
    return SkeletalMotion(reference_body().skeleton, turns, np.stack([time, 1 + 0.1 * np.sin(time), -time], -1), 20.0)


def test_joints_come_back(motion):
    found = skeleton_from_handles(handle_motion_of_body(motion))
    error = degrees(found.world()[0], motion.world()[0])
    assert error.mean() < 0.3 and error.max() < 3
    assert found.skeleton.names == JOINT_NAMES and found.fps == motion.fps
    apart = found.root_translation - motion.root_translation
    assert (
        np.ptp(apart, axis=0).max() < 1e-3 and np.abs(apart[:, [0, 2]]).max() < 1e-3
    )  # along Y the body is set on the ground


def test_rounds_are_what_brings_them_back(motion):
    handles = handle_motion_of_body(motion)
    error = [
        degrees(skeleton_from_handles(handles, rounds).world()[0], motion.world()[0]).mean() for rounds in (0, 2, 12)
    ]
    assert error[0] > 2 * error[1] > 4 * error[2]


def test_a_still_body_stays_still():
    still = HandleMotion(
        np.zeros((2, 30, 3)), np.tile(np.eye(3), (2, 30, 1, 1)), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    )
    found = skeleton_from_handles(still)
    assert np.allclose(found.rotations, np.eye(3), atol=1e-6) and np.allclose(
        found.world()[1][0], reference_body().joints, atol=1e-4
    )
    assert joint_errors(still, found).max() < 1e-4


def test_errors_see_what_is_left_out(motion):
    handles = handle_motion_of_body(motion)
    found = skeleton_from_handles(handles)
    base = joint_errors(handles, found)
    assert base.mean() < 0.01
    moved = handles.translations.copy()
    moved[:, 20] += [0, 0, 0.1]
    stretched = HandleMotion(moved, handles.rotations, handles.root_translation, handles.root_rotation, handles.fps)
    more = joint_errors(stretched, found) - base
    assert more[20] > 0.03 and np.abs(np.delete(more, 20)).max() < 1e-4


def test_handles_of_something_else():
    few = HandleMotion(np.zeros((1, 5, 3)), np.tile(np.eye(3), (1, 5, 1, 1)), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(MotionError, match="5 handles"):
        skeleton_from_handles(few)
