"""Skinning, influences, and the rigid bones that come closest to a moving mesh."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import skin_reference
from scipy.spatial.transform import Rotation

from bunraku.core.character import FEW, Handles, top_influences
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.skinning import decomposed, skin


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


def test_one_rigid_motion_of_all_handles_is_rigid(case):
    vertices, weights, transforms = case
    same = np.broadcast_to(transforms[:, :1], transforms.shape)
    expected = np.einsum("nij,vj->nvi", transforms[:, 0, :, :3], vertices) + transforms[:, 0, None, :, 3]
    np.testing.assert_allclose(skin(vertices, weights, same), expected, atol=2e-6)


@pytest.mark.parametrize("most", [2, 4, 9])
def test_many_vertices_have_the_weights_that_each_has_alone(most: int) -> None:
    random = np.random.default_rng(most)
    weights = np.zeros((FEW + 500, 12), np.float32)
    for row in weights:
        columns = random.permutation(12)[: random.integers(1, most + 1)]
        row[columns] = random.random(len(columns)) + 0.01
    weights /= weights.sum(axis=1, keepdims=True)
    indices, shares = top_influences(weights, 4)
    assert indices.shape == shares.shape == (len(weights), 4)
    kept = Handles(np.zeros((12, 3)), weights).top(4).weights
    for row in range(0, len(weights), 97):
        order = np.argsort(-weights[row], kind="stable")[:4]
        expected = np.zeros(12)
        expected[order] = weights[row, order] / weights[row, order].sum()
        np.testing.assert_allclose(kept[row], expected, atol=1e-6)
        np.testing.assert_allclose(shares[row], expected[order], atol=1e-6)
        used = shares[row] > 0
        assert (indices[row, used] == order[used]).all()


FRAMES = 20


def bent(blend):
    """A strip along x of which two bones hold an end each, with a border between them of so much [m]."""
    x, y = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(-0.2, 0.2, 5))
    rest = np.stack([x, y, 0.05 * np.cos(9 * x)], axis=-1).reshape(-1, 3)
    share = np.clip(0.5 + rest[:, 0] / max(blend, 1e-9), 0, 1)
    angle = np.sin(np.linspace(0, 3, FRAMES))[:, None]
    turns = [matrix_from_axis_angle(angle * axis) for axis in ([0.2, 0.8, 0.3], [0.1, -0.9, 0.6])]
    ways = [np.einsum("nab,mb->nma", turn, rest) + 0.3 * angle[:, None] for turn in turns]
    return rest, share[None, :, None] * ways[1] + (1 - share)[None, :, None] * ways[0]


def test_rigid_pieces_are_found():
    rest, posed = bent(0)
    found = decomposed(rest, posed, 2)
    assert found.error < 1e-6
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1)
    assert ((found.weights > 0.999).sum(axis=1) == 1).all()


def test_weights_are_found_between_bones():
    rest, posed = bent(0.5)
    few, more = decomposed(rest, posed, 2), decomposed(rest, posed, 8)
    assert few.error < 0.05 and more.error < 0.02
    for found in (few, more):
        assert found.weights.min() >= 0 and ((found.weights > 0).sum(axis=1) <= 4).all()
        np.testing.assert_allclose(found.weights.sum(axis=1), 1)
        # the error is that of the skin that is given back
        moved = np.einsum("nbac,mc->nmba", found.rotations, rest) + found.translations[:, None]
        shown = np.einsum("mb,nmba->nma", found.weights, moved)
        assert np.linalg.norm(shown - posed, axis=-1).max() == pytest.approx(found.error)
