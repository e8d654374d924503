import numpy as np

from bunraku.diffusion.features import feature_weights
from bunraku.diffusion.splicing import join_point, splice


def test_join_point_and_splice_of_a_wave_leave_no_jump(features):
    wave = features("left_elbow", frames=60, period=20)
    i, j, distance = join_point(wave, wave, feature_weights())
    joined = splice(wave, wave, i, j)
    assert distance < 1e-3 and len(joined) == i + len(wave) - j
    inside = np.abs(np.diff(wave, axis=0)).max()
    assert np.abs(np.diff(joined, axis=0)).max() < 1.05 * inside
    np.testing.assert_array_equal(joined[:i], wave[:i])
    np.testing.assert_array_equal(joined[-20:], wave[-20:])
