import numpy as np
import pytest

from bunraku.core.motion import HandleMotion
from bunraku.evaluation.motion.seams import handle_places, measure_loop, measure_seams


def sliding(path):
    """A body that slides along x."""
    frames = len(path)
    place = np.zeros((frames, 3))
    place[:, 0] = path
    return HandleMotion(
        np.zeros((frames, 30, 3)), np.tile(np.eye(3), (frames, 30, 1, 1)), place, np.tile(np.eye(3), (frames, 1, 1))
    )


def test_places_follow_the_root():
    motion = sliding([0.0, 0.5])
    np.testing.assert_allclose(
        handle_places(motion)[1] - handle_places(motion)[0], np.tile([0.5, 0, 0], (30, 1)), atol=1e-6
    )


def test_a_jump_counts_where_it_is():
    even = np.arange(100) * 0.01 + 0.001 * (np.arange(100) % 2)  # steps of 11 and 9 mm, changes of 2 mm
    even[50:] += 0.05
    near, far = measure_seams(sliding(even), [50]), measure_seams(sliding(even), [20])
    assert near.displacement == pytest.approx(59 / 11, abs=0.01) and near.displacement_elsewhere == pytest.approx(
        1, abs=0.01
    )
    assert far.displacement == pytest.approx(1, abs=0.01) and far.displacement_elsewhere == near.displacement
    assert near.jump == pytest.approx(24, abs=0.1) and near.jump_elsewhere == pytest.approx(1, abs=0.1)
    assert measure_seams(sliding(even), []).displacement == 0


def test_loops():
    time = np.arange(41) / 40 * 2 * np.pi
    round_trip = measure_loop(sliding(np.sin(time)))
    assert round_trip["pose"] < 1e-6 and round_trip["travel"] < 1e-6 and round_trip["velocity"] < 1.6
    assert (
        measure_loop(sliding(np.abs(np.sin(time / 2))))["velocity"] > 5
    )  # comes back, but not at the speed that it left with
    assert measure_loop(sliding(np.arange(41) * 0.1))["travel"] == pytest.approx(4)
