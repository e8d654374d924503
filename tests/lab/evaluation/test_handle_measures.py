"""Each measure on values that were worked out by hand."""

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.evaluation.handles.measures import (
    NAMED_PARTS,
    accepted_handles,
    drive,
    main_handles,
    part_handles,
    part_meaning,
    part_purity,
    pose_error,
    root_error,
    same_main_handle,
    truncation_error,
    weight_difference,
)

H = {name: index for index, name in enumerate(HANDLE_NAMES)}


def rows(*names: str) -> np.ndarray:
    """Weights of vertices that are wholly of one handle each."""
    return np.eye(HANDLE_COUNT, dtype=np.float32)[[H[name] for name in names]]


def test_the_root_error_is_a_share_of_the_height():
    assert root_error(np.array([0.3, 1, 0.4]), np.array([0.0, 1, 0]), 2.0) == pytest.approx(0.25)


def test_purity_counts_the_vertices_that_go_with_most_of_their_part():
    truth = np.array([[1, 0], [0.95, 0.05], [1, 0], [0.91, 0.09], [0, 1], [0, 1], [0.5, 0.5], [0.1, 0.9]])
    main = np.array(
        [3, 3, 3, 7, 5, 5, 9, 9]
    )  # of part 0 three of four agree, of part 1 both; the last two are of no part for sure
    assert part_purity(main, truth) == pytest.approx(5 / 6)
    assert part_purity(main, np.full((8, 2), 0.5)) is None


def test_the_main_handle_of_a_part_is_by_area():
    target = rows("left_wrist", "left_wrist", "left_fingers", "head")
    weights = rows("left_wrist", "left_wrist", "left_fingers", "left_elbow")
    found = part_handles(weights, np.array([1.0, 1, 3, 1]), target)
    assert found == {"left_hand": H["left_fingers"], "head": H["left_elbow"]}
    assert part_handles(weights, np.array([1.0, 1, 1, 1]), target)["left_hand"] == H["left_wrist"]


def test_a_part_of_two_handles_may_go_by_either_half():
    target = rows("left_wrist", "left_fingers", "spine2", "spine3", "pelvis", "left_ankle")
    weights = rows("left_wrist", "left_fingers", "spine1", "spine3", "pelvis", "left_ankle")
    accepted = accepted_handles(weights, np.array([1.0, 3, 1, 2, 1, 1]), target)
    assert accepted["left_hand"] == {H["left_wrist"], H["left_fingers"]}
    assert accepted["chest"] == {H["spine1"], H["spine3"]}
    assert accepted["hips"] == {0} and accepted["left_foot"] == {H["left_ankle"]} and "head" not in accepted


def test_meaning_is_judged_by_the_reference_and_missing_parts_do_not_count():
    accepted = {"head": {H["head"]}, "hips": {0}, "left_thigh": {H["left_hip"]}}
    target = rows("head", "head", "pelvis", "pelvis", "pelvis")
    weights = rows("head", "neck", "spine1", "spine1", "pelvis")
    right, share = part_meaning(weights, np.array([2.0, 1, 1, 1, 1]), target, accepted)
    assert right == {"head": True, "hips": False}
    assert share == pytest.approx((1 / 2 + 1 / 3) / 2)
    assert part_meaning(weights, np.ones(5), np.zeros((5, HANDLE_COUNT)), accepted) == ({}, None)


def test_every_named_part_is_of_known_handles():
    assert len(NAMED_PARTS) == 15
    assert {handle for part in NAMED_PARTS.values() for handle in part} <= set(HANDLE_NAMES)


def two_parts() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two blocks of eight points, the second of which turns and shifts in two poses."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    rest = np.concatenate([corners, corners + [3, 0, 0]])
    turned = corners @ matrix_from_axis_angle(np.array([0, 0, 0.7])).T + [3, 0.5, 0]
    posed = np.stack([np.concatenate([corners, turned]), np.concatenate([corners, corners + [4, 0, 0]])])
    return rest, posed, np.repeat(np.eye(2), 8, axis=0)


def test_the_right_parts_follow_rigid_poses_exactly():
    rest, posed, weights = two_parts()
    np.testing.assert_allclose(drive(rest, posed, weights), posed, atol=1e-5)
    assert pose_error(rest, posed, weights, 1.0) < 1e-5


def test_the_root_keeps_still_and_baselines_have_none():
    rest, posed, weights = two_parts()
    swapped = weights[:, ::-1]  # now the root is the block that moves
    np.testing.assert_allclose(drive(rest, posed, swapped)[1, 8:], rest[8:], atol=1e-5)
    # In pose 2 half of the vertices are 1 off; in pose 1 they are off by the length of the turned corner's way.
    way = np.linalg.norm(posed[0, 8:] - rest[8:], axis=1).mean()
    assert pose_error(rest, posed, swapped, 2.0) == pytest.approx((way + 1) / 2 / 2 / 2, rel=1e-4)
    assert pose_error(rest, posed, swapped, 2.0, rooted=False) < 1e-5


def test_one_part_for_all_is_worse():
    rest, posed, _ = two_parts()
    # In pose 2 the second of two equal blocks moves by 1 away along the line between them: one rigid part moves by a
    # half.
    assert pose_error(rest, posed[1:], np.ones((16, 1)), 1.0, rooted=False) == pytest.approx(0.5, abs=1e-5)


def test_differences_of_weights_by_hand():
    a, b = np.array([[1, 0, 0], [0.5, 0.5, 0]]), np.array([[0, 1, 0], [0.5, 0.25, 0.25]])
    assert weight_difference(a, b) == pytest.approx((2 + 0.5) / 2)
    assert same_main_handle(a, b) == 0.5
    np.testing.assert_array_equal(main_handles(b), [1, 0])


def test_truncation_is_the_distance_between_the_two_plays():
    rng = np.random.default_rng(0)
    rest, full = rng.normal(size=(20, 3)), rng.dirichlet(np.ones(6), 20).astype(np.float32)
    order = np.argsort(full, axis=1)
    cut = full.copy()
    np.put_along_axis(cut, order[:, :2], 0, axis=1)
    cut /= cut.sum(axis=1, keepdims=True)
    turns = matrix_from_axis_angle(rng.normal(size=(3, 6, 3)))
    transforms = np.concatenate([turns, rng.normal(size=(3, 6, 3, 1))], axis=-1)
    expected = np.linalg.norm(skin(rest, full, transforms) - skin(rest, cut, transforms), axis=-1).mean() / 1.7
    assert truncation_error(rest, full, cut, transforms, 1.7) == pytest.approx(expected, rel=1e-4)
