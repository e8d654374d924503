"""Curves over time: filters, easing, banded systems, and steady values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded

from bunraku.core.geometry.curves import (
    BLOCK,
    MonotoneCurve,
    correlated,
    gaussian,
    running_least,
    running_mean,
    running_most,
    smooth_step,
    solve_banded,
    tallest_steady,
)

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


def test_a_smooth_step_is_level_at_both_ends_and_symmetric():
    assert smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [0, 0, 0.5, 1, 1]
    x = np.linspace(2, 5, 301)
    up = smooth_step(x, 2, 5)
    assert (np.diff(up) > 0).all() and np.abs(np.gradient(up, x)[[0, -1]]).max() < 0.02
    np.testing.assert_allclose(smooth_step(x, 5, 2), 1 - up, atol=1e-12)
    assert smooth_step(np.zeros(2, np.float32)).dtype == np.float32


@pytest.mark.parametrize("count", [2, 3, 4, 30])
def test_a_monotone_curve_is_scipys(count):
    random = np.random.default_rng(count)
    for _ in range(20):
        times = np.cumsum(random.uniform(0.1, 2, count))
        points = random.normal(size=(count, 3)).round(1)  # equal neighbours too
        wanted = np.linspace(times[0] - 0.3, times[-1] + 0.3, 57)
        np.testing.assert_allclose(
            MonotoneCurve(times, points)(wanted), PchipInterpolator(times, points)(wanted), atol=1e-9
        )
    assert MonotoneCurve(times, points)(float(times[1])).tolist() == pytest.approx(points[1].tolist())


@pytest.mark.parametrize("above", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 2, 3, 5, BLOCK - 1, BLOCK, BLOCK + 1, BLOCK + 2, 3 * BLOCK + 7])
def test_solves_as_lapack_does(above: int, count: int) -> None:
    above = min(above, count - 1)
    random = np.random.default_rng(count)
    band = random.uniform(-1, 1, (above + 1, count))
    band[above] = 2 * above + 1 + random.random(count)
    right = random.normal(size=(count, 2))
    np.testing.assert_allclose(solve_banded(band, right), solveh_banded(band, right), atol=1e-12)


def test_who_sits_first_stands_later_and_a_leap_is_no_stance():
    heights = np.r_[np.full(60, 0.5), np.linspace(0.5, 1, 20), np.full(60, 1.0)]
    found = tallest_steady(heights, 20.0)
    assert not found[:70].any() and found[90:].all()
    leap = heights.copy()
    leap[110:116] = 1.6
    assert tallest_steady(leap, 20.0)[85:100].all()
