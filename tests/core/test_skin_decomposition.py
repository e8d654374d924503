"""A movement as a skin, where the skin that made it is known."""

import numpy as np
import pytest

from bunraku.core.skin_decomposition import decomposed
from bunraku.geometry.rotations import matrix_from_axis_angle

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


def test_as_many_bones_as_points_say_all():
    random = np.random.default_rng(0)
    rest, posed = random.normal(size=(4, 3)), random.normal(size=(6, 4, 3))
    assert decomposed(rest, posed, 4).error < 1e-6
