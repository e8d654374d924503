"""Limbs point where the rest poses say, on rigs that stand in other poses."""

import numpy as np
import pytest

from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku_lab.datasets.characters.training_character import (
    TrainingCharacter,
    forward_kinematics,
    handle_target,
    random_pose,
)
from bunraku_lab.evaluation.handles.rest_poses import REST_POSES, limb_directions, posed_limbs

J = {name: index for index, name in enumerate(JOINT_NAMES)}


def stick_figure(seed: int | None = None) -> TrainingCharacter:
    """The reference body's joints as a mesh of 22 points, each wholly of its joint; with a seed in a random pose."""
    joints, parents = np.asarray(reference_body().joints, float), np.array(JOINT_PARENTS)
    none = np.zeros((0, 3))

    def figure(positions: np.ndarray) -> TrainingCharacter:
        weights = np.eye(22, dtype=np.float32)
        target = handle_target(weights, np.arange(22))
        return TrainingCharacter(
            "stick",
            positions,
            none,
            np.ones(22),
            none,
            weights,
            positions,
            parents,
            np.arange(22),
            target,
            positions[0],
            float(np.ptp(positions[:, 1])),
        )

    if seed is None:
        return figure(joints)
    turns = forward_kinematics(joints, parents, random_pose(np.random.default_rng(seed), figure(joints), 0.8))
    return figure(np.einsum("jab,jb->ja", turns[:, :, :3], joints) + turns[:, :, 3])


@pytest.mark.parametrize("seed", [None, 1, 2])
@pytest.mark.parametrize("pose", REST_POSES)
def test_limbs_point_where_the_pose_says(pose, seed):
    figure = stick_figure(seed)
    positions = posed_limbs(figure, pose).astype(float)
    for part, want in limb_directions(pose).items():
        side, name = part.split("_")
        child = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}[name]
        bone = positions[J[f"{side}_{child}"]] - positions[J[part]]
        before = figure.joints[J[f"{side}_{child}"]] - figure.joints[J[part]]
        assert np.linalg.norm(bone) == pytest.approx(np.linalg.norm(before), rel=1e-4)  # bones keep their lengths
        if name in ("hip", "knee") and pose != "sitting":
            assert abs(bone[2]) < 1e-4 and bone[1] < 0
        else:
            np.testing.assert_allclose(bone / np.linalg.norm(bone), want, atol=1e-4)
    np.testing.assert_allclose(positions[: J["left_hip"]], figure.joints[: J["left_hip"]], atol=1e-5)  # the root rests


def test_the_body_in_t_pose_stays_nearly_as_it_is():
    body = reference_body()
    figure = TrainingCharacter(
        "body", body.vertices, np.zeros((0, 3)), np.ones(len(body.vertices)), np.zeros((0, 2)), body.joint_weights,
        np.asarray(body.joints, float),
        np.array(JOINT_PARENTS), np.arange(22), body.handle_weights, body.joints[0], 1.7,
    )  # fmt: skip
    assert np.linalg.norm(posed_limbs(figure, "T") - body.vertices, axis=1).max() < 0.12
    seated, low = posed_limbs(figure, "sitting"), posed_limbs(figure, "arms down")
    assert np.ptp(seated[:, 1]) < 0.85 * np.ptp(body.vertices[:, 1]) and np.ptp(seated[:, 2]) > 1.5 * np.ptp(
        body.vertices[:, 2]
    )
    assert np.ptp(low[:, 0]) < 0.6 * np.ptp(body.vertices[:, 0])


def test_a_rig_without_limbs_is_left_alone():
    figure = stick_figure()
    bare = TrainingCharacter(**{**vars(figure), "handles": np.full(22, -1)})
    np.testing.assert_allclose(posed_limbs(bare, "sitting"), figure.vertices, atol=1e-6)
