import numpy as np
import pytest

from bunraku.core.ground_path import GroundPath, bent_to_path
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError


def test_a_path_goes_through_its_points_from_the_first_to_the_last():
    path = GroundPath(((0, 0), (1, 2), (3, 2)))
    positions = path.positions(121, 20)
    np.testing.assert_allclose(positions[[0, -1]], [[0, 0], [3, 2]], atol=1e-6)
    assert np.linalg.norm(positions - [1, 2], axis=1).min() < 0.05
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) * 20
    assert speed[0] < 0.3 * speed.max() and speed[-1] < 0.3 * speed.max()
    assert np.abs(speed[20:100] - speed[20:100].mean()).max() < 0.25 * speed.mean()


def test_times_are_kept():
    path = GroundPath(((0, 0), (0, 1), (0, 4)), (0.0, 2.0, 3.0))
    np.testing.assert_allclose(path.positions(81, 20)[[0, 40, 60, 80]], [[0, 0], [0, 1], [0, 4], [0, 4]], atol=1e-6)
    with pytest.raises(OptionError, match="after the end"):
        path.positions(40, 20)


def test_who_walks_a_path_looks_along_it():
    path = GroundPath(((0, 0), (2, 0)))
    np.testing.assert_allclose(path.headings(41, 20), np.pi / 2, atol=1e-6)  # +X is a quarter turn from +Z
    np.testing.assert_allclose(path.headings(41, 20, backwards=True), 1.5 * np.pi, atol=1e-6)


@pytest.mark.parametrize(
    "values",
    [((),), (((0, 0),),), (((0, 0), (0, 0)),), (((0, 0), (0, float("inf"))),), (((0, 0), (0, 9999)),),
     (((0, 0), (0, 1)), (0.0,)), (((0, 0), (0, 1)), (1.0, 2.0)), (((0, 0), (0, 1), (0, 2)), (0.0, 2.0, 2.0))],
)  # fmt: skip
def test_paths_that_are_none(values):
    with pytest.raises(OptionError):
        GroundPath(*values)


def test_a_root_is_brought_to_its_path_and_keeps_its_sway():
    frames, path = 100, GroundPath(((0, 0), (0, 4)))
    root = np.zeros((frames, 3))
    root[:, 0] = 0.3 + 0.02 * np.sin(np.arange(frames) * 1.5)
    motion = HandleMotion(np.zeros((frames, 2, 3)), np.broadcast_to(np.eye(3), (frames, 2, 3, 3)), root,
                          np.broadcast_to(np.eye(3), (frames, 3, 3)))  # fmt: skip
    found = bent_to_path(motion, path).root_translation
    off = found[:, [0, 2]] - path.positions(frames, 20)
    assert np.linalg.norm(off, axis=1).max() < 0.05
    assert np.ptp(off[20:80, 0]) > 0.02
