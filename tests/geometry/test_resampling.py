"""Clips at another rate, against scipy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from bunraku.geometry.resampling import Resampling
from bunraku.geometry.rotations import quaternion_from_matrix


@pytest.mark.parametrize("want", [7.0, 20.0, 33.3, 60.0])
def test_values_between_frames_are_those_of_scipy(want):
    rng = np.random.default_rng(0)
    turns = [Rotation.from_rotvec(np.cumsum(0.3 * rng.normal(size=(9, 3)), axis=0)) for _ in range(2)]
    values = rng.normal(size=(9, 2, 3))
    found = Resampling.of(9, 20.0, want)
    assert len(found) == int(8 / 20 * want + 1e-6) + 1
    times = np.arange(len(found)) / want
    known = np.stack([[np.interp(times, np.arange(9) / 20, values[:, i, j]) for j in range(3)] for i in range(2)])
    np.testing.assert_allclose(found.linear(values), known.transpose(2, 0, 1), atol=1e-12)
    got = found.rotations(np.stack([turn.as_matrix() for turn in turns], axis=1))
    for joint, turn in enumerate(turns):
        np.testing.assert_allclose(
            got[:, joint], Slerp(np.arange(9) / 20, turn)(np.minimum(times, 0.4)).as_matrix(), atol=1e-9
        )


def test_one_frame_stays_and_floats_keep_their_precision():
    found = Resampling.of(1, 20.0, 50.0)
    assert len(found) == 1
    values = np.ones((1, 4), np.float32)
    assert found.linear(values).dtype == np.float32
    np.testing.assert_array_equal(found.linear(values), values)
    turn = Rotation.from_euler("x", 50, degrees=True).as_matrix()[None]
    np.testing.assert_allclose(
        found.quaternions(quaternion_from_matrix(turn)), quaternion_from_matrix(turn), atol=1e-15
    )
