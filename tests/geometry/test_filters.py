"""Filters in time against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from bunraku.geometry.filters import correlated, gaussian, running_least, running_mean, running_most

LENGTHS = (1, 2, 3, 7, 120)


@pytest.mark.parametrize("count", LENGTHS)
@pytest.mark.parametrize("edge", ["nearest", "mirror", "wrap"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blurs_as_scipy_does(count: int, edge: str, dtype: type) -> None:
    values = np.random.default_rng(count).normal(size=(count, 2, 3)).astype(dtype)
    for deviation in (0.3, 1.7, 6.0):
        found = gaussian(values, deviation, edge)
        assert found.dtype == dtype
        np.testing.assert_array_equal(found, ndimage.gaussian_filter1d(values, deviation, axis=0, mode=edge))
    kernel = np.array([-3, 12, 17, 12, -3]) / 35
    np.testing.assert_array_equal(correlated(values, kernel, edge), ndimage.convolve1d(values, kernel, 0, mode=edge))


@pytest.mark.parametrize("count", LENGTHS)
@pytest.mark.parametrize("size", [1, 2, 5, 10, 31])
def test_runs_as_scipy_does(count: int, size: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    for mine, scipys in (
        (running_mean, ndimage.uniform_filter1d),
        (running_least, ndimage.minimum_filter1d),
        (running_most, ndimage.maximum_filter1d),
    ):
        np.testing.assert_array_equal(mine(values, size), scipys(values, size, mode="nearest"))


def test_nothing_stays_nothing() -> None:
    assert correlated(np.zeros((0, 3)), np.ones(3)).shape == (0, 3)


def test_says_which_edges_there_are() -> None:
    with pytest.raises(ValueError, match="nearest, mirror, wrap"):
        gaussian(np.zeros(3), 1.0, "odd")
