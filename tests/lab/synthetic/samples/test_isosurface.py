"""Surfaces of values on a grid against libigl's, whose cubes are cut by another table."""

import igl
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from bunraku_lab.synthetic.samples.isosurface import CUBE, marching_cubes

THEIRS = np.array([0, 1, 3, 2, 4, 5, 7, 6])
"""Corners of a cube in the order of libigl."""


def grid(values):
    """The surface of values on a grid, ours and libigl's."""
    shape = values.shape
    points = np.argwhere(np.ones(shape)).astype(float)
    cells = np.argwhere(np.ones(np.array(shape) - 1))
    cubes = np.ravel_multi_index(np.moveaxis(cells[:, None] + CUBE, -1, 0), shape)
    theirs = igl.marching_cubes(values.reshape(-1), points, np.ascontiguousarray(cubes[:, THEIRS]), 0.0)[:2]
    return marching_cubes(values.reshape(-1), points, cubes), theirs


def volume(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


def test_a_rough_field_has_a_closed_surface_through_the_same_points():
    """White noise, so that every case of a cube occurs, and all that touch in a side."""
    values = np.random.default_rng(0).normal(size=(14, 14, 14))
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 1
    (vertices, faces), (theirs, _) = grid(values)
    np.testing.assert_allclose(np.array(sorted(map(tuple, vertices))), np.array(sorted(map(tuple, theirs))), atol=1e-12)
    sides = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    once = set(zip(*(side.tolist() for side in sides), strict=True))
    assert len(once) == faces.size  # no side is used twice in a direction, and each has its other face
    assert once == {(b, a) for a, b in once}


def test_a_smooth_field_has_the_volume_that_libigl_finds():
    values = gaussian_filter(np.random.default_rng(1).normal(size=(24, 24, 24)), 3.0)
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 0.01
    ours, theirs = (volume(np.asarray(one[0]), np.asarray(one[1])) for one in grid(values))
    assert ours == pytest.approx(theirs, rel=5e-3) and ours > 100  # wound outward


def test_no_surface():
    (vertices, faces), _ = grid(np.ones((3, 3, 3)))
    assert vertices.shape == (0, 3) and faces.shape == (0, 3)
