import numpy as np
import pytest

from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.motion.seams import measure_seams, posed_positions


def sliding(path):
    """A body that slides along x."""
    frames = len(path)
    position = np.zeros((frames, 3))
    position[:, 0] = path
    return HandleMotion(
        np.zeros((frames, 30, 3)), np.tile(np.eye(3), (frames, 30, 1, 1)), position, np.tile(np.eye(3), (frames, 1, 1))
    )


def test_places_follow_the_root():
    motion = sliding([0.0, 0.5])
    np.testing.assert_allclose(
        posed_positions(motion)[1] - posed_positions(motion)[0], np.tile([0.5, 0, 0], (30, 1)), atol=1e-6
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
