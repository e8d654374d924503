"""Weighted rigid registration against a case by hand, its readable reference and scipy's align_vectors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.geometry.registration import part_means, register, register_reference


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    source = rng.normal(size=(120, 3))
    weights = rng.random((120, 6)) ** 6
    weights /= weights.sum(axis=1, keepdims=True)
    turns = Rotation.random(5, random_state=2).as_matrix()
    targets = source @ turns.transpose(0, 2, 1) + 0.3 * rng.normal(size=(5, 120, 3)) + rng.normal(size=(5, 1, 3))
    return source, targets, weights


def test_quarter_turn_by_hand():
    """A square of side 2 about (1, 0, 0) turns a quarter about +Z and goes up by 5: worked out on paper."""
    source = np.array([[0, -1, 0], [2, -1, 0], [2, 1, 0], [0, 1, 0]], float)
    target = np.array([[[2, -1, 5], [2, 1, 5], [0, 1, 5], [0, -1, 5]]], float)
    rotations, translations = register(source, target, np.ones((4, 1)))
    np.testing.assert_allclose(rotations[0, 0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-7)
    np.testing.assert_allclose(translations[0, 0], [0, 0, 5], atol=1e-12)


def test_fast_path_equals_reference(case):
    source, targets, weights = case
    rotations, translations = register(source, targets, weights)
    for frame in range(5):
        for part in range(6):
            handle, rotation, translation = register_reference(source, targets[frame], weights[:, part])
            np.testing.assert_allclose(rotations[frame, part], rotation, atol=1e-6)
            np.testing.assert_allclose(translations[frame, part], translation, atol=1e-6)
            np.testing.assert_allclose(part_means(source, weights)[part], handle, atol=1e-12)


def test_agrees_with_align_vectors(case):
    source, targets, weights = case
    rotations, _ = register(source, targets, weights)
    for part in range(6):
        w = weights[:, part]
        a = targets[3] - np.average(targets[3], axis=0, weights=w)
        b = source - np.average(source, axis=0, weights=w)
        np.testing.assert_allclose(
            rotations[3, part], Rotation.align_vectors(a, b, weights=w)[0].as_matrix(), atol=1e-6
        )


def test_rigid_motion_comes_back_about_any_handles(case):
    source, _, weights = case
    turn, shift = Rotation.random(random_state=5).as_matrix(), np.array([3.0, -1, 2])
    handles = np.random.default_rng(1).normal(size=(6, 3))
    rotations, translations = register(source, (source @ turn.T + shift)[None], weights, handles)
    moved = (source[:, None] - handles) @ turn.T + handles + translations[0]
    np.testing.assert_allclose(rotations[0], np.broadcast_to(turn, (6, 3, 3)), atol=1e-6)
    np.testing.assert_allclose(moved, np.broadcast_to((source @ turn.T + shift)[:, None], moved.shape), atol=1e-5)


def test_a_mirrored_target_gives_a_rotation_still(case):
    source, _, weights = case
    rotations, _ = register(source, (source * [-1, 1, 1])[None], weights)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)


def test_parts_that_fix_no_rotation():
    """No weight, one point, two points, a plane: finite rotations, as near to the identity as the points allow."""
    source = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.3, 0.2, 0]], float)
    target = source @ Rotation.from_euler("z", 90, degrees=True).as_matrix().T + [0, 0, 2]
    weights = np.zeros((5, 4))
    weights[0, 1] = 1
    weights[:2, 2] = 1
    weights[:, 3] = 1
    rotations, translations = register(source.astype(np.float32), target[None].astype(np.float32), weights)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    np.testing.assert_allclose(rotations[0, :2], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-9)
    np.testing.assert_allclose(translations[0, 0], target.mean(0) - source.mean(0), atol=1e-6)
    np.testing.assert_allclose(rotations[0, 2:] @ [1, 0, 0], [[0, 1, 0]] * 2, atol=1e-6)
    np.testing.assert_allclose(rotations[0, 2] @ [0, 0, 1], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(rotations[0, 3] @ [0, 0, 1], [0, 0, 1], atol=1e-6)


def test_far_from_the_origin_in_float32(case):
    source, _, weights = case
    turn = Rotation.random(random_state=7).as_matrix()
    rotations, _ = register((source + 50).astype(np.float32), (source @ turn.T - 80)[None].astype(np.float32), weights)
    np.testing.assert_allclose(rotations[0], np.broadcast_to(turn, (6, 3, 3)), atol=1e-5)
