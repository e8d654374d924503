"""Edge splitting: conforming, complete, bounded, and without a change of the surface."""

import numpy as np
import pytest
import trimesh

from bunraku.geometry.graph import unique_edges
from bunraku.geometry.subdivision import split_estimate, split_long_edges
from bunraku.geometry.surface import vertex_areas


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


def test_short_edges_stay():
    mesh = trimesh.creation.icosphere(2)
    vertices, faces, rounds = split_long_edges(np.asarray(mesh.vertices), np.asarray(mesh.faces), 5)
    assert not rounds
    np.testing.assert_array_equal(faces, mesh.faces)
    np.testing.assert_array_equal(vertices, mesh.vertices)


def test_one_giant_triangle_is_bounded():
    vertices = np.array([[0, 0, 0], [1000, 0, 0], [0, 1000, 0]], float)
    _, faces, _ = split_long_edges(vertices, np.array([[0, 1, 2]]), 0.5, max_faces=3000)
    assert 500 < len(faces) <= 3001


def test_estimate_is_of_the_right_size():
    mesh = trimesh.creation.box()
    _, faces, _ = split_long_edges(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.05)
    assert 0.2 < split_estimate(mesh.vertices, mesh.faces, 0.05) / len(faces) < 5
    assert split_estimate(mesh.vertices, mesh.faces, 10) == 0
