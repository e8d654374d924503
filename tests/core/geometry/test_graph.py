"""The clean graph of a zoo of awkward meshes."""

import numpy as np
import pytest
import trimesh

from bunraku.core.geometry.graph import (
    _first_alike,
    bridge_edges,
    canonical_order,
    clean_mesh,
    mean_operator,
    mesh_parts,
    pack,
    unique_edges,
    unpack_pairs,
)
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


def test_distinct_vertices_are_not_welded():
    vertices = np.random.default_rng(0).uniform(-1, 1, (60_000, 3))
    assert len(clean_mesh(vertices, np.arange(60_000).reshape(-1, 3)).vertices) == 60_000


def test_scale_and_offset_only_round(sphere):
    vertices, faces = sphere[0].astype(np.float32), sphere[1]
    clean = clean_mesh(vertices, faces)
    for scale, offset in ((0.01, 0), (100, 0), (1, 8)):
        moved = clean_mesh((vertices * np.float32(scale) + np.float32(offset)).astype(np.float32), faces)
        np.testing.assert_allclose(moved.vertices[moved.index], clean.vertices[clean.index], atol=2e-6)
        np.testing.assert_allclose(moved.vertices, clean.vertices, atol=2e-6)


def test_repeated_and_degenerate_faces_go(sphere):
    vertices, faces = sphere
    extra = np.concatenate([faces, faces[:50], np.roll(faces[:20], 1, axis=1), [[0, 0, 1], [2, 2, 2]]])
    same(clean_mesh(vertices, extra), clean_mesh(vertices, faces))


def test_of_both_orientations_the_outward_one_stays(sphere):
    vertices, faces = sphere
    both = np.concatenate([faces[:, ::-1], faces])
    same(clean_mesh(vertices, both), clean_mesh(vertices, faces))


def test_vertices_without_faces_follow_their_nearest(sphere):
    vertices, faces = sphere
    stray = np.concatenate([[[1e4, 0, 0]], vertices, vertices[7:8] * 1.001, [[np.nan, 0, 0]]])
    clean, plain = clean_mesh(stray, faces + 1), clean_mesh(vertices, faces)
    same(clean, plain)  # the far one does not count in the bounding box
    assert clean.index[-2] == plain.index[7]
    assert clean.used.sum() == len(vertices)


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


def test_single_triangle_and_flat_plane():
    assert len(clean_mesh(np.eye(3), np.array([[2, 1, 0]])).faces) == 1
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    grid = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(3)[:, None] * 5 + np.arange(4)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 6], 1), np.stack([corner, corner + 6, corner + 5], 1)]
    )
    assert len(clean_mesh(grid, faces).vertices) == 20


def test_canonical_order_sorts_ties():
    points = np.random.default_rng(0).integers(0, 3, (200, 3)).astype(float)
    order = np.random.default_rng(1).permutation(200)
    np.testing.assert_array_equal(points[canonical_order(points)], points[order][canonical_order(points[order])])


def test_pack_keeps_lexicographic_order():
    rows = np.random.default_rng(0).integers(0, 50, (100, 3))
    for count in (50, 2**31):
        order = np.argsort(pack(rows, count), kind="stable")
        np.testing.assert_array_equal(order, np.lexsort(rows.T[::-1]))


def test_edges_and_parts_agree_with_trimesh():
    mesh = trimesh.util.concatenate(
        [trimesh.creation.icosphere(1), trimesh.creation.box().apply_translation([3, 0, 0])]
    )
    faces = np.asarray(mesh.faces)
    edges = unique_edges(faces, len(mesh.vertices))
    np.testing.assert_array_equal(edges, np.unique(np.sort(mesh.edges, axis=1), axis=0))
    np.testing.assert_array_equal(mesh_parts(edges, len(mesh.vertices)), np.repeat([0, 1], [42, 8]))


def test_mean_operator_is_a_mean():
    edges = np.array([[0, 1], [1, 2]])
    values = np.array([1.0, 2, 6, 9], np.float32)
    np.testing.assert_allclose(mean_operator(edges, 4) @ values, [2, 3.5, 2, 9])
    np.testing.assert_allclose(mean_operator(edges, 4, own=True) @ values, [1.5, 3, 4, 9])


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


def test_one_part_needs_no_bridge(sphere):
    vertices, faces = sphere
    assert bridge_edges(vertices, parts_of(faces, len(vertices))).shape == (0, 2)


def test_the_first_place_of_each_key_is_that_of_unique():
    random = np.random.default_rng(0)
    for most in (5, 400, 10**9):
        key = random.integers(0, most, 300)
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        np.testing.assert_array_equal(_first_alike(key), first[inverse])


@pytest.mark.parametrize("count", [1_000, 3_000_000])  # whose pairs do not fit into 32 bits
def test_pairs_of_keys_of_any_size(count):
    pairs = np.random.default_rng(1).integers(0, count, (300, 2))
    found = unpack_pairs(np.concatenate([pairs, pairs[:40]]) @ [count, 1], count)
    assert found.dtype == np.int64 and np.array_equal(found, np.unique(pairs, axis=0))
    assert unpack_pairs(np.zeros(0, np.int64), count).shape == (0, 2)


def test_parts_do_not_depend_on_the_order_of_edges():
    edges = np.array([[4, 1], [0, 2], [5, 4], [2, 6]])
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        assert mesh_parts(edges[order], 8).tolist() == [0, 1, 0, 2, 1, 1, 0, 3]
    assert mesh_parts(np.zeros((0, 2), int), 3).tolist() == [0, 1, 2]
