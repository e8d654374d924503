"""Smooth ways from one value to another."""

import numpy as np

from bunraku.geometry.easing import smooth_step


def test_a_smooth_step_is_level_at_both_ends_and_symmetric():
    assert smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [0, 0, 0.5, 1, 1]
    x = np.linspace(2, 5, 301)
    up = smooth_step(x, 2, 5)
    assert (np.diff(up) > 0).all() and np.abs(np.gradient(up, x)[[0, -1]]).max() < 0.02
    np.testing.assert_allclose(smooth_step(x, 5, 2), 1 - up, atol=1e-12)
    assert smooth_step(np.zeros(2, np.float32)).dtype == np.float32
