"""One matrix product against the definition of linear blend skinning."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.core.skinning import skin, skin_basis, skin_reference


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    weights = rng.random((70, 5)).astype(np.float32)
    weights /= weights.sum(axis=1, keepdims=True)
    transforms = np.concatenate([Rotation.random(20, random_state=1).as_matrix(), rng.normal(size=(20, 3, 1))], axis=2)
    return rng.normal(size=(70, 3)).astype(np.float32), weights, transforms.reshape(4, 5, 3, 4)


def test_product_equals_definition(case):
    posed = skin(*case)
    assert posed.shape == (4, 70, 3) and posed.dtype == np.float32
    np.testing.assert_allclose(posed, skin_reference(*case), atol=2e-6)


def test_identity_moves_nothing(case):
    vertices, weights, _ = case
    still = np.broadcast_to(np.eye(3, 4), (2, 5, 3, 4))
    np.testing.assert_allclose(skin(vertices, weights, still), np.stack([vertices] * 2), atol=1e-6)


def test_one_rigid_motion_of_all_handles_is_rigid(case):
    vertices, weights, transforms = case
    same = np.broadcast_to(transforms[:, :1], transforms.shape)
    expected = np.einsum("nij,vj->nvi", transforms[:, 0, :, :3], vertices) + transforms[:, 0, None, :, 3]
    np.testing.assert_allclose(skin(vertices, weights, same), expected, atol=2e-6)


def test_vertex_of_one_handle_follows_it_alone(case):
    vertices, weights, transforms = case
    weights = np.zeros_like(weights)
    weights[:, 3] = 1
    expected = vertices @ transforms[2, 3, :, :3].T + transforms[2, 3, :, 3]
    np.testing.assert_allclose(skin(vertices, weights, transforms)[2], expected, atol=2e-6)


def test_basis_holds_weighted_homogeneous_positions(case):
    vertices, weights, _ = case
    basis = skin_basis(vertices, weights).reshape(5, 4, 70)
    np.testing.assert_allclose(basis[2, 1], weights[:, 2] * vertices[:, 1], atol=1e-7)
    np.testing.assert_array_equal(basis[2, 3], weights[:, 2])


def test_no_frames(case):
    vertices, weights, transforms = case
    assert skin(vertices, weights, transforms[:0]).shape == (0, 70, 3)
