"""Surfaces: points on them, subdivision, winding, extremes, and the closest point."""

import igl
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from bunraku.core.geometry.closest import blend_matrix, least_distance, stars_of
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.geometry.surface import (
    extreme_points,
    split_long_edges,
    surface_points,
    vertex_areas,
    vertex_normals,
)


def test_sphere_normals_point_outward():
    sphere = trimesh.creation.icosphere(3)
    for size in (1e-7, 1.0, 1e6):
        normals = vertex_normals(sphere.vertices * size, sphere.faces)
        assert ((normals * sphere.vertices).sum(axis=1) > 0.999).all()


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


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.box(extents=[1, 2, 0.1]), trimesh.creation.icosphere(1), trimesh.creation.cone(1, 3)]
)
def test_split_keeps_the_surface_and_its_holes(mesh):
    vertices, faces, _ = split_long_edges(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.11)
    edges = unique_edges(faces, len(vertices))
    assert np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).max() <= 0.11
    split = trimesh.Trimesh(vertices, faces, process=False)
    assert split.is_watertight and split.is_winding_consistent
    assert split.volume == pytest.approx(mesh.volume)
    assert vertex_areas(vertices, faces).sum() == pytest.approx(mesh.area)


def test_rounds_rebuild_the_vertices():
    mesh = trimesh.creation.box()
    vertices, _, rounds = split_long_edges(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.3)
    built = np.asarray(mesh.vertices)
    for pairs in rounds:
        built = np.concatenate([built, built[pairs].mean(axis=1)])
    np.testing.assert_array_equal(built, vertices)


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


def test_corners_of_a_box_are_its_extreme_points():
    rng = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
    points = np.concatenate([rng.uniform(0.1, 0.9, (500, 3)), corners])
    assert extreme_points(points).tolist() == list(range(500, 508))


def test_they_are_on_the_convex_hull_and_hardly_miss_any_of_it():
    points = np.random.default_rng(1).normal(size=(3000, 3)) * [1, 2, 0.5]
    picked = extreme_points(points, 160)
    assert set(picked) <= set(ConvexHull(points.astype(np.float32)).vertices)
    for turn in Rotation.random(50, random_state=0):
        heights = turn.apply(points)[:, 1]
        assert heights[picked].min() - heights.min() < 0.03 * np.ptp(heights)


def case():
    mesh = trimesh.creation.torus(1, 0.4, major_sections=24, minor_sections=12)
    rng = np.random.default_rng(0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)
    points = mesh.sample(800, seed=1) + rng.normal(size=(800, 3)) * 0.02
    home = np.linalg.norm(points[:, None] - vertices, axis=2).argmin(axis=1)
    return points, home, vertices, faces, stars_of(vertices, faces, unique_edges(faces, len(vertices)))


def test_narrow_blend_is_the_nearest_point():
    points, home, vertices, faces, stars = case()
    theirs = igl.point_mesh_squared_distance(points, vertices, faces)[2]
    np.testing.assert_allclose(blend_matrix(points, home, stars, 1e-5) @ vertices, theirs, atol=1e-4)


def test_a_poor_home_walks_to_the_nearest_point():
    points, home, vertices, faces, stars = case()
    edges = unique_edges(faces, len(vertices))
    neighbour = {int(a): int(b) for a, b in edges} | {int(b): int(a) for a, b in edges}
    poor = np.array([neighbour[int(vertex)] for vertex in home])
    good = blend_matrix(points, home, stars, 0.01)
    np.testing.assert_allclose(blend_matrix(points, poor, stars, 0.01) @ vertices, good @ vertices, atol=0.02)


def test_weights_change_smoothly_across_a_ridge():
    """Points on a line over the ridge of a roof: no step between neighbours is much larger than their distance."""
    vertices = np.array([[-1, 0, 0], [0, 0.3, -1], [0, 0.3, 1], [1, 0, 0]], float)
    faces = np.array([[0, 2, 1], [3, 1, 2]])
    points = np.stack(
        [np.linspace(-0.3, 0.3, 301), np.full(301, 0.1), np.zeros(301)], axis=1
    )  # inside, where nearest points jump
    stars = stars_of(vertices, faces, unique_edges(faces, 4))
    weights = blend_matrix(points, np.full(301, 1), stars, 0.2).toarray()
    assert np.abs(np.diff(weights, axis=0)).max() < 0.01


def test_a_hub_is_bounded():
    angle = np.linspace(0, 2 * np.pi, 2001)[:-1]
    vertices = np.concatenate([[[0, 0, 0]], np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)])
    rim = np.arange(2000)
    faces = np.stack([0 * rim, 1 + rim, 1 + (rim + 1) % 2000], axis=1)
    stars = stars_of(vertices, faces, unique_edges(faces, 2001))
    weights = blend_matrix(vertices, np.arange(2001), stars, 1e-4)
    np.testing.assert_allclose(weights @ vertices, vertices, atol=1e-3)


def test_least_distance_is_that_of_all_pairs():
    rng = np.random.default_rng(3)
    for apart in (0.0, 0.5, 30.0):
        one, other = rng.normal(0, 1, (300, 3)), rng.normal(0, 1, (500, 3)) + [apart, 0, 0]
        want = np.linalg.norm(one[:, None] - other[None], axis=-1).min()
        assert abs(least_distance(cKDTree(one), other) - want) < 1e-12
    assert least_distance(cKDTree(one), one) == 0
