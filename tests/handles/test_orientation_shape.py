"""What a shape would rest on, and where its top leans."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from bunraku.geometry.axes import AXES, ORIENTATIONS, axis_vector, upright_rotation
from bunraku.geometry.surface import surface_points
from bunraku.handles.orientation_evidence import combined, surface_witnesses
from bunraku.handles.orientation_shape import _carried, lean, rest

CUBE = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6], [0, 4, 5], [0, 5, 1],
                 [1, 5, 6], [1, 6, 2], [2, 6, 7], [2, 7, 3], [3, 7, 4], [3, 4, 0]])  # fmt: skip


def box(low, high):
    """Corners of a box with outward faces `CUBE`."""
    (x, y, z), (u, v, w) = low, high
    return np.array([(x, y, z), (x, v, z), (u, v, z), (u, y, z), (x, y, w), (x, v, w), (u, v, w), (u, y, w)], float)


def statue():
    """A head that looks along +Z on a neck, on a plinth, as points and normals."""
    boxes = [box((-0.5, 0, -0.5), (0.5, 0.2, 0.5)), box((-0.1, 0.2, -0.1), (0.1, 1, 0.1))]
    boxes += [box((-0.15, 1, -0.1), (0.15, 1.3, 0.4))]
    faces = np.concatenate([CUBE + 8 * n for n in range(3)])
    points, normals = surface_points(np.concatenate(boxes), faces, 4000)
    return points, normals


def test_what_stands_on_a_plinth_rests_on_it():
    points, normals = statue()
    found = rest(points, normals)
    up = AXES.index("+y")
    assert found[up, 0] > np.log(0.15) and found[up, 1] > 0.99 and found[up, 2] > 0.9
    others = np.delete(found, up, axis=0)
    assert others[:, 2].max() < 0.7 and found[AXES.index("-y"), 1] > 0.5  # upside down it stands on its head


def test_a_ball_rests_on_nothing():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = rest(normals * 3, normals)
    assert np.ptp(found[:, 0]) < 1.5 and found[:, 2].max() < 0.3
    assert np.isfinite(rest(np.zeros((5, 3)), normals[:5])).all() and np.isfinite(lean(np.zeros((5, 3)))).all()


def test_a_head_is_in_front():
    points, _ = statue()
    found = lean(points)
    upright = [found[ORIENTATIONS.index(("+y", front))] for front in ("+z", "-z", "+x", "-x")]
    assert upright[0] == pytest.approx(0.15 / 1.3, abs=0.02)  # of the largest extent, its height
    assert upright[1] == pytest.approx(-upright[0]) and np.abs(upright[2:]).max() < 0.01


def test_turning_the_shape_turns_what_it_tells():
    points, normals = statue()
    told = surface_witnesses(points, normals)
    assert told.argmax() == ORIENTATIONS.index(("+y", "+z"))
    for up, front in ORIENTATIONS[::5]:
        turn = upright_rotation(up, front)
        again = surface_witnesses(points @ turn, normals @ turn)
        assert again.argmax() == ORIENTATIONS.index((up, front))
        assert np.sort(again) == pytest.approx(np.sort(told), abs=1e-6)
    assert np.ptp(told) <= np.log(115) + np.log(10.4) + 1e-6


def test_bones_are_a_witness_like_others():
    back, usual = ORIENTATIONS.index(("+y", "-z")), ORIENTATIONS.index(("+y", "+z"))
    network = np.full(24, 0.01 / 22)
    network[[back, usual]] = 0.49, 0.5
    assert combined(network, bones=("+y", "-z"))[back] > 0.95
    network[[back, usual]] = 0.003, 0.987  # names may be swapped: the shape is asked too
    assert 0.05 < combined(network, bones=("+y", "-z"))[usual] < 0.95
    assert axis_vector("-z")[2] == -1


def test_a_hull_in_the_plane_is_that_of_qhull():
    random = np.random.default_rng(0)
    for size in (3, 5, 40, 400):
        points, middle = random.normal(0, 0.2, (size, 2)), random.normal(0, 0.05, 2)
        hull = ConvexHull(points)
        inside, area = _carried(points, middle)
        assert abs(inside + float((hull.equations[:, :2] @ middle + hull.equations[:, 2]).max())) < 1e-9
        assert area == pytest.approx(hull.volume, rel=1e-9)
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]])
    assert _carried(square, np.array([0.25, 0.5])) == pytest.approx((0.25, 1.0))
    assert _carried(square, np.array([2.0, 0.5])) == pytest.approx((-1.0, 1.0))
    assert _carried(square[:2], np.zeros(2)) == _carried(square * [1, 0], np.zeros(2)) == (-1.0, 0.0)
