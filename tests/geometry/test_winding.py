"""Winding numbers against libigl's and against sums over all faces by its formula."""

import igl
import numpy as np
import pytest
import trimesh

from bunraku.geometry.winding import winding_numbers


@pytest.fixture(scope="module")
def torn():
    """A ring with a hole in its side, and a loose sheet in its middle; points all around and close by."""
    ring = trimesh.creation.torus(1.0, 0.4, 96, 48)
    vertices, faces = np.asarray(ring.vertices), np.asarray(ring.faces)
    faces = faces[~((vertices[faces][..., 0] > 1.2).all(axis=1) & (np.abs(vertices[faces][..., 1]) < 0.3).all(axis=1))]
    sheet = np.array([[-0.3, -0.3, 0], [0.3, -0.3, 0.1], [0.3, 0.3, 0], [-0.3, 0.3, 0.1]])
    soup = np.concatenate([faces, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])])
    random = np.random.default_rng(0)
    near = vertices[random.integers(0, len(vertices), 3000)] + random.normal(0, 0.02, (3000, 3))
    return np.concatenate([vertices, sheet]), soup, np.concatenate([random.uniform(-2, 2, (3000, 3)), near])


def test_sums_of_clusters_are_the_sums_of_all_faces(torn):
    vertices, faces, points = torn
    exact = igl.winding_number(vertices, faces, points)
    found = winding_numbers(points, vertices, faces)
    assert np.abs(found - exact).max() < 0.02
    sides = (np.abs(found) > 0.5) != (np.abs(exact) > 0.5)
    assert sides.mean() < 1e-3


def test_inside_is_one_and_outside_none():
    ball = trimesh.creation.icosphere(3, 1.0)
    points = np.array([[0.0, 0, 0], [0.9, 0, 0], [1.1, 0, 0], [50.0, 3, 1]])
    assert winding_numbers(points, np.asarray(ball.vertices), np.asarray(ball.faces)) == pytest.approx(
        [1, 1, 0, 0], abs=5e-3
    )
    assert winding_numbers(points[:0], np.asarray(ball.vertices), np.asarray(ball.faces)).shape == (0,)
