"""Motion copied onto an embedded skeleton, on the reference body itself, where the copy is nearly exact."""

import numpy as np
import pytest

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import CharacterError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.baselines.skeletal_retarget import RiggedMesh, copied_motion, rig_by_embedding


def bending(angle):
    """Two frames: the T-pose, and the left elbow turned about Y while the root moves a metre ahead."""
    body, turns = reference_body(), np.zeros((2, JOINT_COUNT, 3))
    turns[1, JOINT_NAMES.index("left_elbow"), 1] = angle
    root = body.joints[0] + np.array([[0, 0, 0], [0, 0, 1.0]])
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), root, 20.0)


@pytest.fixture(scope="module")
def rigged():
    body = reference_body()
    return rig_by_embedding(body.vertices, body.faces)


def test_the_skeleton_is_found_and_at_rest_nothing_moves(rigged):
    body = reference_body()
    gap = np.linalg.norm(rigged.joints - body.joints, axis=1)
    assert np.median(gap) < 0.08 and (np.count_nonzero(rigged.weights, axis=1) <= 4).all()
    np.testing.assert_allclose(rigged.weights.sum(axis=1), 1, atol=1e-6)
    at_rest, moved = copied_motion(rigged, bending(0.9))
    np.testing.assert_allclose(at_rest, body.vertices, atol=1e-6)
    legs = body.joint_weights[:, JOINT_NAMES.index("right_knee")] > 0.99
    assert np.linalg.norm(moved[legs] - at_rest[legs] - [0, 0, 1], axis=1).mean() < 0.06  # a leg may be a little longer


def test_on_the_body_itself_the_joints_go_where_its_skeleton_takes_them():
    body = reference_body()
    own = RiggedMesh(body.joints, body.joints, np.eye(JOINT_COUNT))  # each joint a vertex of its own
    motion = bending(np.pi / 2)
    np.testing.assert_allclose(copied_motion(own, motion), motion.world()[1], atol=1e-6)
    np.testing.assert_allclose(copied_motion(own, motion, aligned=True), motion.world()[1], atol=1e-6)


def test_arms_that_hang_are_taken_to_the_t_pose_first():
    body = reference_body()
    joints, shoulder = body.joints.copy(), JOINT_NAMES.index("left_shoulder")
    down = matrix_from_axis_angle(np.array([0, 0, -np.pi / 2]))
    below = [shoulder]
    for joint in range(JOINT_COUNT):  # parents come first
        if JOINT_PARENTS[joint] in below:
            below.append(joint)
            joints[joint] = (body.joints[joint] - body.joints[shoulder]) @ down.T + body.joints[shoulder]
    hanging = RiggedMesh(joints, joints, np.eye(JOINT_COUNT))
    wrist = JOINT_NAMES.index("left_wrist")
    still = bending(0.0)
    np.testing.assert_allclose(copied_motion(hanging, still)[0, wrist], joints[wrist], atol=1e-9)
    np.testing.assert_allclose(copied_motion(hanging, still, aligned=True)[0, wrist], body.joints[wrist], atol=1e-6)


def test_a_mesh_without_a_surface_is_refused():
    with pytest.raises(CharacterError):
        rig_by_embedding(np.zeros((3, 3)), np.array([[0, 1, 2]]))
