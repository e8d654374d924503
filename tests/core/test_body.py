"""The reference body: its shape, its parts, and joint rotations from handles."""

import numpy as np
import pytest
import trimesh
from oracles import joint_errors
from scipy.spatial.transform import Rotation

from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import (
    HANDLE_COUNT,
    HANDLE_MIRROR,
    HANDLE_NAMES,
    HANDLE_PARENTS,
    JOINT_COUNT,
    JOINT_MIRROR,
    JOINT_NAMES,
    PARTS,
    kept_handles,
)
from bunraku.core.body.reference import handle_positions, reference_body, reference_shapes
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import OptionError
from bunraku.generation.features import encode, feature_mask
from bunraku_lab.datasets.motions.build import handle_motion_of_body


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


def names(keep):
    return {HANDLE_NAMES[i] for i in np.flatnonzero(kept_handles(keep))}


def test_words_name_handles():
    assert names("left arm") == {"left_collar", "left_shoulder", "left_elbow", "left_wrist", "left_fingers"}
    assert names(["Left-Arm"]) == names("left_arm") and names("left arm, right arm") == names("arms")
    assert names("left_wrist") == {"left_wrist"} and names(["head_top", "tail"]) == {"head_top", "tail", "tail_tip"}
    assert names("left leg") == {"pelvis", "left_hip", "left_knee", "left_ankle", "left_foot"} and names("root") == {
        "pelvis"
    }
    assert names("upper body") | names("lower body") == set(HANDLE_NAMES) and not names("upper body") & names(
        "lower body"
    )
    assert names("head") == {"neck", "head", "head_top", "face"}


def test_words_that_name_nothing_or_all():
    with pytest.raises(OptionError, match=r"no part 'lags'.*legs"):
        kept_handles("lags")
    with pytest.raises(OptionError, match="all handles"):
        kept_handles(["upper body", "lower body"])


@pytest.mark.parametrize("part", list(PARTS))
def test_features_of_a_part_change_with_its_handles_only(part):
    rng, handles = np.random.default_rng(0), kept_handles(part)
    still = HandleMotion(
        np.zeros((5, 30, 3)), np.tile(np.eye(3), (5, 30, 1, 1)), np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1))
    )
    translations, root = np.zeros((5, 30, 3)), np.zeros((5, 3))
    translations[:, handles] = rng.normal(size=(5, int(handles.sum()), 3))
    translations[:, 0] = 0
    if handles[0]:
        root = rng.normal(size=(5, 3))
    change = encode(HandleMotion(translations, still.rotations, root, still.root_rotation)) != encode(still)
    mask = feature_mask(handles)
    assert mask.shape == (271,) and not change[:, ~mask].any() and change[:, mask].any()


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
