"""Winding numbers and distances against libigl's."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from bunraku.geometry.closest import surface_distances
from bunraku.geometry.winding import winding_numbers


@pytest.fixture(scope="module", params=["whole", "with holes", "two that cut each other"])
def mesh(request):
    ball = trimesh.creation.icosphere(4, 0.3)
    vertices, faces = np.asarray(ball.vertices, float), np.asarray(ball.faces, np.int64)
    if request.param == "with holes":
        faces = faces[vertices[faces].mean(axis=1)[:, 1] < 0.2]
    if request.param == "two that cut each other":
        vertices, faces = np.concatenate([vertices, vertices + 0.2]), np.concatenate([faces, faces + len(vertices)])
    return vertices, np.ascontiguousarray(faces)


def test_winding_numbers_are_those_of_all_solid_angles(mesh):
    vertices, faces = mesh
    points = np.random.default_rng(0).uniform(-0.6, 0.7, (3000, 3))
    found, exact = winding_numbers(points, vertices, faces), igl.winding_number(vertices, faces, points)
    assert np.abs(found - exact).max() < 0.03
    clear = np.abs(np.abs(exact) - 0.5) > 0.03
    np.testing.assert_array_equal(np.abs(found[clear]) > 0.5, np.abs(exact[clear]) > 0.5)
    assert winding_numbers(np.zeros((0, 3)), vertices, faces).shape == (0,)


def test_distances_are_those_to_the_nearest_point_of_any_face(mesh):
    vertices, faces = mesh
    points = np.random.default_rng(1).uniform(-0.4, 0.5, (3000, 3))
    found = surface_distances(points, vertices, faces, 0.015)
    exact = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
    assert (found > exact - 1e-9).all() and (found - exact).max() < 0.15 * 0.015
    assert np.quantile(found - exact, 0.98) < 1e-6
