"""The clean graph of a zoo of awkward meshes."""

import numpy as np
import pytest
import trimesh

from bunraku.core.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.errors import CharacterError


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(3)
    return np.asarray(mesh.vertices) * [1, 2, 0.7] + [3, 1, -5], np.asarray(mesh.faces)


def parts_of(faces, count):
    return mesh_parts(unique_edges(faces, count), count)


def same(a, b):
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.faces, b.faces)


def test_normalised_and_invertible(sphere):
    vertices, faces = sphere
    clean = clean_mesh(vertices, faces)
    np.testing.assert_allclose(clean.vertices.min(0) + clean.vertices.max(0), 0, atol=1e-12)
    assert np.ptp(clean.vertices, axis=0).max() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(clean.vertices[clean.index] * clean.scale + clean.center, vertices, atol=1e-12)
    assert trimesh.Trimesh(clean.vertices, clean.faces, process=False).volume * clean.scale**3 == pytest.approx(
        trimesh.Trimesh(vertices, faces).volume
    )


def test_order_of_vertices_and_faces_does_not_matter(sphere):
    vertices, faces = sphere
    rng = np.random.default_rng(0)
    order = rng.permutation(len(vertices))
    shuffled = np.roll(np.argsort(order)[faces][rng.permutation(len(faces))], 1, axis=1)
    clean, again = clean_mesh(vertices, faces), clean_mesh(vertices[order], shuffled)
    same(clean, again)
    np.testing.assert_array_equal(again.index, clean.index[order])


def test_soup_is_welded(sphere):
    vertices, faces = sphere
    soup = clean_mesh(vertices[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3))
    same(soup, clean_mesh(vertices, faces))
    np.testing.assert_array_equal(soup.index, clean_mesh(vertices, faces).index[faces.reshape(-1)])


def test_seams_that_nearly_meet_are_welded(sphere):
    vertices, faces = sphere
    noise = np.random.default_rng(1).uniform(-4e-6, 4e-6, (faces.size, 3))  # 1e-6 of the height
    assert len(clean_mesh(vertices[faces.reshape(-1)] + noise, np.arange(faces.size).reshape(-1, 3)).vertices) == len(
        vertices
    )


def test_scale_and_offset_only_round(sphere):
    vertices, faces = sphere[0].astype(np.float32), sphere[1]
    clean = clean_mesh(vertices, faces)
    for scale, offset in ((0.01, 0), (100, 0), (1, 8)):
        moved = clean_mesh((vertices * np.float32(scale) + np.float32(offset)).astype(np.float32), faces)
        np.testing.assert_allclose(moved.vertices[moved.index], clean.vertices[clean.index], atol=2e-6)
        np.testing.assert_allclose(moved.vertices, clean.vertices, atol=2e-6)


def test_of_both_orientations_the_outward_one_stays(sphere):
    vertices, faces = sphere
    both = np.concatenate([faces[:, ::-1], faces])
    same(clean_mesh(vertices, both), clean_mesh(vertices, faces))


def test_non_manifold_edge():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], float)
    clean = clean_mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    assert len(clean.faces) == 3 and len(unique_edges(clean.faces, 5)) == 7


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), "no faces"),
        (np.zeros((4, 3)), np.array([[0, 1, 2]]), "one point"),
        (np.eye(3), np.array([[0, 1, 3]]), "does not exist"),
        (np.eye(3), np.array([[0, 1, -1]]), "does not exist"),
        (np.array([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]]), np.array([[0, 1, 2]]), "not numbers"),
        (np.array([[0, 0, 0], [1, 0, 0], [np.inf, 1, 0]]), np.array([[0, 1, 2]]), "not numbers"),
        (np.eye(3), np.array([[0, 0, 1], [1, 1, 2]]), "degenerate"),
        (np.eye(3), np.zeros((0, 4), int), r"\(F, 3\)"),
    ],
)
def test_what_is_no_surface_is_refused(vertices, faces, words):
    with pytest.raises(CharacterError, match=words):
        clean_mesh(vertices, faces)


def test_edges_and_parts_agree_with_trimesh():
    mesh = trimesh.util.concatenate(
        [trimesh.creation.icosphere(1), trimesh.creation.box().apply_translation([3, 0, 0])]
    )
    faces = np.asarray(mesh.faces)
    edges = unique_edges(faces, len(mesh.vertices))
    np.testing.assert_array_equal(edges, np.unique(np.sort(mesh.edges, axis=1), axis=0))
    np.testing.assert_array_equal(mesh_parts(edges, len(mesh.vertices)), np.repeat([0, 1], [42, 8]))


def test_bridges_join_twenty_parts_with_few_edges():
    rng = np.random.default_rng(0)
    spheres = [
        trimesh.creation.icosphere(2, radius=r).apply_translation(t)
        for r, t in zip(rng.uniform(0.05, 0.4, 20), rng.uniform(-3, 3, (20, 3)), strict=True)
    ]
    mesh = trimesh.util.concatenate(spheres)
    vertices, parts = np.asarray(mesh.vertices), parts_of(np.asarray(mesh.faces), len(mesh.vertices))
    bridges = bridge_edges(vertices, parts)
    assert parts.max() == 19
    assert (parts[bridges[:, 0]] != parts[bridges[:, 1]]).all() and (bridges[:, 0] < bridges[:, 1]).all()
    edges = np.concatenate([unique_edges(np.asarray(mesh.faces), len(vertices)), bridges])
    assert mesh_parts(edges, len(vertices)).max() == 0
    assert len(bridges) <= 2 * 3 * 19
    small = np.flatnonzero(parts == parts[-1])
    near = np.linalg.norm(vertices[small][:, None] - vertices[parts != parts[-1]][None], axis=2).min()
    mine = bridges[(parts[bridges] == parts[-1]).any(axis=1)]
    assert np.linalg.norm(vertices[mine[:, 0]] - vertices[mine[:, 1]], axis=1).min() == pytest.approx(near, abs=2e-3)
