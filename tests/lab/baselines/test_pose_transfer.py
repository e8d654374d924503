"""Pose transfer, and a skeleton's motion copied."""

import numpy as np
import pytest
import torch

from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku_lab.baselines.pose_transfer import (
    RiggedMesh,
    TransferTarget,
    copied_motion,
    rig_by_embedding,
    source_body,
    source_motion,
    source_rotations,
)
from bunraku_lab.nn.pose_transfer import TransferConfig, TransferNetwork


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


QUARTER = matrix_from_axis_angle(np.array([0.0, 0, np.pi / 2]))


def test_the_source_turns_as_the_reference_body():
    """A character that rests in the body's own T-pose hands its turns over; the root's are taken out."""
    turns = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    turns[0, 16] = QUARTER  # the left shoulder
    whole = np.tile(QUARTER, (1, 1, 1, 1)) @ turns
    np.testing.assert_allclose(source_rotations(whole, reference_body().joints), turns, atol=1e-6)
    body = source_body()
    still = body.posed(np.tile(np.eye(3, dtype=np.float32), (1, JOINT_COUNT, 1, 1)))[0]
    np.testing.assert_allclose(still, body.mesh.rest, atol=1e-5)


@pytest.fixture(scope="module")
def dancer():
    """The reference body with its knee and its shoulder bent, and how it goes there."""
    body = reference_body()
    turns = np.tile(np.eye(3), (3, JOINT_COUNT, 1, 1))
    turns[1, [4, 7, 10]] = matrix_from_axis_angle(np.array([0.8, 0, 0]))
    turns[2, [16, 18, 20]] = matrix_from_axis_angle(np.array([0, 0, -0.9]))
    positions = np.zeros((3, JOINT_COUNT, 3))
    positions[:, 0] = body.joints[0]
    parents = body.skeleton.parents
    for joint in range(1, JOINT_COUNT):
        offset = body.joints[joint] - body.joints[parents[joint]]
        positions[:, joint] = positions[:, parents[joint]] + turns[:, parents[joint]] @ offset
    shifts = positions - np.einsum("njab,jb->nja", turns, body.joints)
    affine = np.concatenate([turns, shifts[..., None]], axis=3)
    return body, affine, np.asarray(skin(body.vertices, body.joint_weights, affine))


def test_untrained_transfer_moves_the_body_as_its_parts(dancer):
    """Its parts are those of the source, so it stays near the truth, and at rest it is where it was."""
    body, affine, truth = dancer
    torch.manual_seed(0)
    network = TransferNetwork(TransferConfig(levels=(4, 5), code=6)).eval()
    target = TransferTarget.of(body.vertices, body.faces, body.handle_weights, body.joints[0], network)
    moved = target.with_joints(affine, body.joints)
    assert moved.shape == truth.shape
    gap = np.linalg.norm(moved - truth, axis=2).mean(axis=1)
    away = np.linalg.norm(truth - body.vertices, axis=2).mean(axis=1)
    assert gap[0] < 0.02 and (gap[1:] < 0.5 * away[1:]).all()


def test_a_target_with_lowered_arms_is_moved_from_its_own_rest(dancer):
    """A body that rests in an A-pose: the source rests as it does, so untrained parts stay near the truth too."""
    body, affine, truth = dancer
    lowered = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    for side, joints in ((-1, [16, 18, 20]), (1, [17, 19, 21])):
        lowered[0, joints] = matrix_from_axis_angle(np.array([0, 0, side * 0.7]))
    joints = body.joints.copy()
    for joint in range(1, JOINT_COUNT):
        parent = int(body.skeleton.parents[joint])
        joints[joint] = joints[parent] + lowered[0, parent] @ (body.joints[joint] - body.joints[parent])
    shifts = joints - np.einsum("jab,jb->ja", lowered[0], body.joints)
    down = np.concatenate([lowered[0], shifts[..., None]], axis=2)
    rest = np.asarray(skin(body.vertices, body.joint_weights, down[None]))[0]
    back = lowered[0].transpose(0, 2, 1)
    turns = affine[..., :3] @ back
    own = np.concatenate([turns, affine[..., 3:] - turns @ shifts[..., None]], axis=3)  # off the A-pose
    torch.manual_seed(0)
    network = TransferNetwork(TransferConfig(levels=(4, 5), code=6)).eval()
    target = TransferTarget.of(rest, body.faces, body.handle_weights, joints[0], network)
    gap = np.linalg.norm(target.with_joints(own, joints) - np.asarray(skin(rest, body.joint_weights, own)), axis=2)
    away = np.linalg.norm(truth - rest, axis=2).mean(axis=1)
    assert (gap.mean(axis=1) < 0.25 * away).all()


def test_a_motion_travels_with_its_root():
    body = reference_body()
    frames = 4
    still = np.tile(np.eye(3), (frames, 30, 1, 1))
    path = np.linspace([0, 0, 0], [0, 0, 1.5], frames)
    motion = HandleMotion(np.zeros((frames, 30, 3)), still, path, np.tile(np.eye(3), (frames, 1, 1)))
    torch.manual_seed(0)
    network = TransferNetwork(TransferConfig(levels=(4,), code=3)).eval()
    twice = 2 * body.vertices
    target = TransferTarget.of(twice, body.faces, body.handle_weights, 2 * body.joints[0], network)
    moved = target.with_motion(source_motion(network, skeleton_from_handles(motion)), 2 * body.joints[0])
    step = (moved - moved[:1]).mean(axis=1)
    np.testing.assert_allclose(step, 2 * path, atol=0.02)
