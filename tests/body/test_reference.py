"""The reference body: a closed, symmetric T-pose whose handles and joints say the same."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from bunraku.body.layout import (
    HANDLE_COUNT,
    HANDLE_MIRROR,
    HANDLE_NAMES,
    HANDLE_PARENTS,
    JOINT_COUNT,
    JOINT_MIRROR,
    JOINT_NAMES,
)
from bunraku.body.reference import handle_positions, reference_body, reference_shapes
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import MotionError


def test_it_is_a_closed_body_of_about_2500_vertices():
    body = reference_body()
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert 2000 < len(body.vertices) < 3000
    assert mesh.is_watertight and mesh.euler_number == 2
    assert 0.05 < mesh.volume < 0.09  # cubic metres: a person of 50 to 90 kg
    assert abs(body.vertices[:, 1].min()) < 0.01


@pytest.mark.parametrize("shape", reference_shapes())
def test_every_shape_stands_in_a_t_pose_and_is_symmetric(shape):
    body = reference_body(shape)
    np.testing.assert_allclose(body.vertices[body.mirror] * [-1, 1, 1], body.vertices, atol=2e-3)
    np.testing.assert_allclose(body.joints[list(JOINT_MIRROR)] * [-1, 1, 1], body.joints, atol=1e-4)
    joint = {name: body.joints[i] for i, name in enumerate(JOINT_NAMES)}
    assert joint["left_wrist"][0] > joint["left_elbow"][0] > joint["left_shoulder"][0] > 0  # left is +X
    assert np.ptp([joint[f"left_{part}"][1] for part in ("shoulder", "elbow", "wrist")]) < 1e-3
    assert joint["left_foot"][2] > joint["left_ankle"][2]  # toes point to +Z
    assert joint["head"][1] > joint["neck"][1] > joint["spine3"][1] > joint["pelvis"][1] > joint["left_knee"][1]


def test_handles_split_joints_and_nothing_else():
    body = reference_body()
    np.testing.assert_allclose(body.handle_weights.sum(axis=1), 1, atol=1e-5)
    merged = body.handle_weights[:, :JOINT_COUNT].copy()
    for handle in range(JOINT_COUNT, HANDLE_COUNT - 2):  # fingers, scalp, face and wings give back to their parents
        merged[:, HANDLE_PARENTS[handle]] += body.handle_weights[:, handle]
    np.testing.assert_allclose(merged, body.joint_weights, atol=2e-3)
    assert body.handle_weights[:, HANDLE_NAMES.index("tail")].max() == 0
    np.testing.assert_allclose(body.handle_weights[body.mirror][:, list(HANDLE_MIRROR)], body.handle_weights, atol=2e-3)


def test_handle_positions_do_not_depend_on_tessellation():
    body = reference_body()
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    fine = mesh.subdivide(face_index=np.flatnonzero(mesh.triangles_center[:, 0] > 0))  # twice as dense on the left only

    def area(m):
        return np.bincount(m.faces.ravel(), np.repeat(m.area_faces / 3, 3), minlength=len(m.vertices))

    def smooth(v):
        return np.stack([np.exp(-20 * v[:, 0] ** 2), 1 - np.exp(-20 * v[:, 0] ** 2)], axis=1)

    coarse = handle_positions(mesh.vertices, smooth(mesh.vertices), area(mesh))
    np.testing.assert_allclose(handle_positions(fine.vertices, smooth(fine.vertices), area(fine)), coarse, atol=5e-3)


def test_posing_turns_the_forearm_about_the_elbow():
    body = reference_body()
    rotations = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    elbow = JOINT_NAMES.index("left_elbow")
    rotations[0, elbow] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    posed = body.pose(SkeletalMotion(body.skeleton, rotations, body.joints[:1]))[0]
    hand = body.joint_weights[:, JOINT_NAMES.index("left_wrist")] > 0.99
    arm = body.vertices[hand] - body.joints[elbow]
    np.testing.assert_allclose(
        posed[hand] - body.joints[elbow], np.stack([-arm[:, 1], arm[:, 0], arm[:, 2]], axis=1), atol=5e-3
    )
    still = body.joint_weights[:, elbow] + body.joint_weights[:, JOINT_NAMES.index("left_wrist")] < 1e-4
    np.testing.assert_allclose(posed[still], body.vertices[still], atol=1e-3)


def test_another_skeleton_is_refused():
    body = reference_body()
    other = Skeleton(("root",), [-1], np.zeros((1, 3)))
    with pytest.raises(MotionError, match="22 joints"):
        body.pose(SkeletalMotion(other, np.eye(3)[None, None], np.zeros((1, 3))))
