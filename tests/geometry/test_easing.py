"""Smooth ways from one value to another."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from bunraku.geometry.easing import MonotoneCurve, smooth_step


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
