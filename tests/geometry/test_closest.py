"""Nearest points and their weights against libigl's search over the whole mesh."""

import igl
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from bunraku.geometry.closest import blend_matrix, least_distance, stars_of, surface_distances
from bunraku.geometry.graph import unique_edges


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


def test_weights_are_shares():
    points, home, _, _, stars = case()
    weights = blend_matrix(points, home, stars, 0.05)
    assert weights.data.min() > 0
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)), 1, atol=1e-6)


def test_bare_edges_and_lone_vertices_carry_points():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [5, 5, 5]], float)
    points = np.array([[0.25, 0.3, 0], [-1, 0, 0], [5, 6, 5]])
    stars = stars_of(vertices, np.zeros((0, 3), int), np.array([[0, 1]]))
    weights = blend_matrix(points, np.array([0, 1, 2]), stars, 0.01)
    np.testing.assert_allclose(weights.toarray(), [[0.75, 0.25, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)


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


def test_distances_from_anywhere_are_those_that_libigl_finds():
    points, _, vertices, faces, _ = case()
    points = np.concatenate([points, np.random.default_rng(1).uniform(-2, 2, (2000, 3))])
    theirs = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
    found = surface_distances(points, vertices, faces, 0.1, 0.5)
    near = theirs < 0.4
    assert np.abs(found - theirs)[near].max() < 0.005 and np.quantile(np.abs(found - theirs)[near], 0.99) < 1e-6
    assert np.isinf(found[theirs > 0.6]).all()
