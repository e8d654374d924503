"""Rigid registration for training, against the one that runs and against differences."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from bunraku.geometry.registration import part_means, register
from bunraku_lab.nn.registration import register_torch


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    source = rng.normal(size=(120, 3))
    weights = rng.random((120, 6)) ** 6
    weights /= weights.sum(axis=1, keepdims=True)
    turns = Rotation.random(5, random_state=2).as_matrix()
    targets = source @ turns.transpose(0, 2, 1) + 0.3 * rng.normal(size=(5, 120, 3)) + rng.normal(size=(5, 1, 3))
    return source, targets, weights


def test_torch_equals_numpy(case):
    source, targets, weights = case
    rotations, translations = register(source, targets, weights)
    theirs = register_torch(*(torch.tensor(array) for array in case))
    np.testing.assert_allclose(theirs[0], rotations, atol=1e-9)
    np.testing.assert_allclose(theirs[1], translations, atol=1e-9)
    np.testing.assert_allclose(theirs[2], part_means(source, weights), atol=1e-12)


def test_torch_gradients_equal_differences(case):
    source, targets, weights = (torch.tensor(array[:12] if array.ndim == 2 else array[:2, :12]) for array in case)
    weights = weights[:, :2].clone().requires_grad_()

    def moved(w):
        rotations, translations, handles = register_torch(source, targets, w)
        return torch.einsum("nkij,kj->nki", rotations, handles), translations

    assert torch.autograd.gradcheck(moved, (weights,), atol=1e-6)


def test_torch_gradients_are_finite_where_singular_values_coincide():
    """A cube (three equal singular values), a line, a point and an empty part."""
    cube = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    weights = torch.zeros(8, 4)
    weights[:, 0], weights[:2, 1], weights[0, 2] = 1, 1, 1
    weights.requires_grad_()
    rotations, translations, handles = register_torch(cube, cube[None] + 0.5, weights)
    (rotations.square() @ torch.rand(3, 3)).sum().add(translations.sum() + handles.sum()).backward()
    assert torch.isfinite(weights.grad).all()
    torch.testing.assert_close(rotations.detach()[0], torch.eye(3).expand(4, 3, 3))
