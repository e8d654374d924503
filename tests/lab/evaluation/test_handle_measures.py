"""The measures of handles, against values by hand."""

import numpy as np
import pytest
import trimesh
from foreign_files import edge_error

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import part_means, register, skin
from bunraku.files.samples import sample_character
from bunraku_lab.evaluation.handles.measures import (
    accepted_handles,
    drive,
    part_meaning,
    part_purity,
    pose_error,
    refine_registration,
    resampled,
    root_error,
    stretch_of,
    truncation_error,
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


@pytest.fixture
def arm():
    """A bar of two bones whose weights blend widely, in three true poses."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (400, 3)) * [1, 0.2, 0.2]
    share = np.clip(0.5 + x[:, 0], 0, 1)
    weights = np.stack([1 - share, share], axis=1)
    turns = np.asarray(matrix_from_axis_angle(rng.normal(0, 0.6, (3, 2, 3))))
    turns[:, 0] = np.eye(3)
    truth = np.concatenate([turns, np.zeros((3, 2, 3, 1))], axis=-1)
    return x, weights, truth, skin(x.astype(np.float32), weights.astype(np.float32), truth)


def plain(x, posed, weights):
    rotations, translations = register(x, posed, weights)
    handles = part_means(x, weights)
    offset = handles + translations - np.einsum("nkij,kj->nki", rotations, handles)
    return np.concatenate([rotations, offset[..., None]], axis=-1)


def error(x, posed, weights, transforms):
    return float(np.square(skin(x.astype(np.float32), weights.astype(np.float32), transforms) - posed).sum())


def test_true_motions_are_found_again_where_weights_blend(arm):
    x, weights, truth, posed = arm
    start = plain(x, posed, weights)
    found = refine_registration(x, posed, weights, start, sweeps=60)
    assert error(x, posed, weights, found) < 1e-3 * error(x, posed, weights, start)
    np.testing.assert_allclose(found, truth, atol=0.02)
    turns = found[..., :3]
    np.testing.assert_allclose(turns @ turns.swapaxes(-1, -2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-9)


def test_every_sweep_helps_and_fixed_parts_stay(arm):
    x, weights, _, posed = arm
    start = plain(x, posed, weights)
    start[:, 0] = np.eye(3, 4)
    errors = [
        error(x, posed, weights, refine_registration(x, posed, weights, start, fixed=(0,), sweeps=n)) for n in range(4)
    ]
    assert errors == sorted(errors, reverse=True) and errors[3] < errors[0]
    assert np.array_equal(refine_registration(x, posed, weights, start, fixed=(0,))[:, 0], start[:, 0])


@pytest.mark.parametrize("count", [1_000, 5_000, 50_000])
def test_the_surface_stays_and_the_vertices_are_as_many(count):
    dog = sample_character("dog")
    other = resampled(dog, count)
    assert 0.9 * count < len(other.vertices) < 1.15 * count
    np.testing.assert_allclose(np.ptp(other.vertices, axis=0), np.ptp(dog.vertices, axis=0), rtol=0.03)
    tree = trimesh.Trimesh(dog.vertices, dog.faces, process=False)
    _, distance, _ = trimesh.proximity.closest_point_naive(tree, other.vertices[:: max(1, count // 50)])
    assert distance.max() < 0.02 * dog.height


def test_two_edges_of_three_are_stretched():
    """One vertex of a triangle is carried off along its edge to the next; the third one stays at a right angle."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    weights = np.zeros((3, 2), np.float32)
    weights[[0, 2], 0], weights[1, 1] = 1, 1
    character = Character("triangle", vertices, np.array([[0, 1, 2]]))
    handles = Handles(vertices[:2], weights)
    shift = np.zeros((7, 2, 3))
    shift[6, 1, 0] = 4.0
    turns = np.tile(np.eye(3), (7, 2, 1, 1))
    found = stretch_of(character, handles, HandleMotion(shift, turns, np.zeros((7, 3)), turns[:, 0]))
    assert found["most_stretched"] == pytest.approx(5)
    assert found["stretched_edges"] == pytest.approx(
        2 / 3
    )  # the other edge of the vertex is sqrt(26 / 2) times as long
    still = stretch_of(character, handles, HandleMotion(0 * shift, turns, np.zeros((7, 3)), turns[:, 0]))
    assert still == {"stretched_edges": 0.0, "most_stretched": 1.0}


def test_the_edge_error_is_the_mean_change_of_length():
    """One vertex of a triangle is shifted by its edge's length in one of two frames that are looked at."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    weights = np.array([[1, 0], [0, 1], [1, 0]], np.float32)
    character = Character("triangle", vertices, np.array([[0, 1, 2]]))
    shift = np.zeros((4, 2, 3))
    shift[3, 1, 0] = 1.0
    turns = np.tile(np.eye(3), (4, 2, 1, 1))
    motion = HandleMotion(shift, turns, np.zeros((4, 3)), turns[:, 0])
    changes = np.array([[0, 0, 0], [1, 0, np.sqrt(5 / 2) - 1]])
    assert edge_error(character, Handles(vertices[:2], weights), motion) == pytest.approx(changes.mean(), rel=1e-5)
