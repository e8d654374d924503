"""Points spread over a surface by area."""

import numpy as np

from bunraku.geometry.axes import right_angle_rotations
from bunraku.geometry.surface import surface_points

SQUARES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [3, 0, 6], [0, 0, 6]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])


def test_points_lie_on_the_surface_by_area():
    points, normals = surface_points(SQUARES, FACES, 400)
    first = points[:, 2] == 0
    assert first.sum() == 100  # a square of area 1 and a rectangle of area 3
    assert np.array_equal(normals[first], np.tile([0, 0, 1], (100, 1))) and np.array_equal(
        normals[~first], np.tile([0, -1, 0], (300, 1))
    )
    assert (points[first, :2] >= 0).all() and (points[first, :2] <= 1).all() and np.abs(points[~first, 1]).max() == 0
    quarters = np.histogram2d(points[first, 0], points[first, 1], 2, [[0, 1], [0, 1]])[0]
    assert quarters.min() >= 20
    mean = points[~first].mean(axis=0)
    assert np.abs(mean - [1.5, 0, 5.5]).max() < 0.05


def test_points_turn_with_the_mesh():
    points, normals = surface_points(SQUARES, FACES, 50)
    for rotation in right_angle_rotations():
        turned, bent = surface_points(SQUARES @ rotation.T.astype(np.float32), FACES, 50)
        assert np.abs(turned - points @ rotation.T).max() < 1e-12 and np.abs(bent - normals @ rotation.T).max() < 1e-12


def test_a_mesh_without_area_gives_its_corners():
    points, normals = surface_points(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32), np.array([[0, 1, 2]]), 10)
    assert np.isfinite(points).all() and np.array_equal(normals, np.zeros((10, 3)))
