"""Vertex normals of shapes whose normals are known."""

import numpy as np
import trimesh

from bunraku.geometry.surface import face_normals, vertex_normals


def test_sphere_normals_point_outward():
    sphere = trimesh.creation.icosphere(3)
    for size in (1e-7, 1.0, 1e6):
        normals = vertex_normals(sphere.vertices * size, sphere.faces)
        assert ((normals * sphere.vertices).sum(axis=1) > 0.999).all()


def test_degenerate_faces_change_nothing():
    sphere = trimesh.creation.icosphere(2)
    faces = np.concatenate([sphere.faces, [[0, 0, 1], [3, 3, 3], [1, 2, 2]]])
    np.testing.assert_array_equal(vertex_normals(sphere.vertices, faces), vertex_normals(sphere.vertices, sphere.faces))


def test_vertices_without_area_point_up():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [5, 5, 5]], float)
    there_and_back = np.array([[0, 1, 2], [0, 2, 1]])
    np.testing.assert_array_equal(vertex_normals(vertices, there_and_back), [[0, 1, 0]] * 4)
    np.testing.assert_array_equal(vertex_normals(vertices, there_and_back, unit=False), np.zeros((4, 3)))


def test_large_faces_weigh_more():
    """A vertex between a face of area 3 that looks along +Z and one of area 1 that looks along +X."""
    vertices = np.array([[0, 0, 0], [6, 0, 0], [0, 1, 0], [0, 0, -2]], float)
    normals = vertex_normals(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    turned = np.array([-1, 0, 3]) / np.sqrt(10)
    np.testing.assert_allclose(np.abs(normals[0]), np.abs(turned), atol=1e-12)


def test_face_normals_have_twice_the_area():
    triangle = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0]], float)
    np.testing.assert_array_equal(face_normals(triangle, np.array([[0, 1, 2]])), [[0, 0, 6]])
