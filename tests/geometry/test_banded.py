"""The banded solver against scipy's, which calls LAPACK."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solveh_banded

from bunraku.geometry.banded import BLOCK, solve_banded


@pytest.mark.parametrize("above", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 2, 3, 5, BLOCK - 1, BLOCK, BLOCK + 1, BLOCK + 2, 3 * BLOCK + 7])
def test_solves_as_lapack_does(above: int, count: int) -> None:
    above = min(above, count - 1)
    random = np.random.default_rng(count)
    band = random.uniform(-1, 1, (above + 1, count))
    band[above] = 2 * above + 1 + random.random(count)
    right = random.normal(size=(count, 2))
    np.testing.assert_allclose(solve_banded(band, right), solveh_banded(band, right), atol=1e-12)
