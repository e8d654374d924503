"""Meshes with fewer triangles: still surfaces, of the same shape, as even as those that libigl thins."""

import igl
import numpy as np
import trimesh

from bunraku_lab.synthetic.samples.thinning import thinned


def test_a_ball_stays_a_closed_ball():
    ball = trimesh.creation.icosphere(4, 1.0)
    vertices, faces = thinned(np.asarray(ball.vertices), np.asarray(ball.faces), 1000)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert 950 < len(faces) <= 1000 and mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert abs(mesh.volume / ball.volume - 1) < 0.02
    theirs, few, _, _ = igl.decimate(
        np.asfortranarray(ball.vertices), np.asfortranarray(np.asarray(ball.faces, np.int32)), 1000
    )
    wide, other = (np.ptp(trimesh.Trimesh(v, f, process=False).edges_unique_length)
                   for v, f in ((vertices, faces), (theirs, np.asarray(few))))  # fmt: skip
    assert wide < 1.3 * other


def test_a_border_stays():
    """An open cylinder: what is left of its two rims lies on them, and no triangle closes it."""
    tube = trimesh.creation.cylinder(1.0, 2.0, 48).subdivide().subdivide()
    faces = np.asarray(tube.faces)[np.abs(tube.face_normals[:, 2]) < 0.5]
    vertices, few = thinned(np.asarray(tube.vertices), faces, 400)
    mesh = trimesh.Trimesh(vertices, few, process=False)
    assert len(few) <= 400 and mesh.euler_number == 0
    sides = np.sort(mesh.edges, axis=1)
    unique, uses = np.unique(sides, axis=0, return_counts=True)
    rim = np.unique(unique[uses == 1])
    np.testing.assert_allclose(np.abs(vertices[rim, 2]), 1.0, atol=1e-9)


def test_what_cannot_be_thinner_stays():
    """A tetrahedron would be two triangles on one another."""
    solid = trimesh.creation.box().convex_hull
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert len(thinned(points, faces, 2)[1]) == 4
    assert len(thinned(np.asarray(solid.vertices), np.asarray(solid.faces), 1)[1]) == 4
