import numpy as np
import pytest

from bunraku.core.skinning import skin
from bunraku.geometry.registration import part_means, register
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.evaluation.handles.joint_registration import refine_registration


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


def test_hard_weights_have_nothing_to_gain(arm):
    x, weights, _, posed = arm
    hard = np.eye(2)[weights.argmax(axis=1)]
    start = plain(x, posed, hard)
    np.testing.assert_allclose(refine_registration(x, posed, hard, start), start, atol=1e-6)
