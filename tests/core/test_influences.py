"""The largest weights of many vertices are those of each vertex alone."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.core.character import FEW, Handles, top_influences


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
