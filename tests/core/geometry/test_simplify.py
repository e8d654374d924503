"""The network mesh: its size, its independence from how the shape is stored, and the maps to and from the original."""

import numpy as np
import pytest
import trimesh

from bunraku.core.geometry.graph import mesh_parts
from bunraku.core.geometry.simplify import network_mesh
from bunraku.errors import CharacterError


def smooth(points):
    x, y, z = points.T
    return np.stack(
        [np.sin(3 * x), np.cos(2 * y + z), np.exp(-8 * ((points - [0.2, 0.3, 0]) ** 2).sum(axis=1))], axis=1
    )


def figure(level: int = 3) -> trimesh.Trimesh:
    """A body with two legs and two arms that overlap it, as seven loose parts, one of them tiny."""
    ball = trimesh.creation.icosphere(level)
    shapes = [
        ((0.3, 0.5, 0.2), (0, 1.2, 0)), ((0.2, 0.22, 0.2), (0, 1.9, 0)), ((0.12, 0.6, 0.12), (0.16, 0.5, 0)), ((0.12,
        0.6, 0.12), (-0.16, 0.5, 0)),
        ((0.5, 0.08, 0.08), (0.6, 1.5, 0)), ((0.5, 0.08, 0.08), (-0.6, 1.5, 0)), ((0.004, 0.004, 0.004), (0.05, 1.95,
        0.2)),
    ]  # fmt: skip
    return trimesh.util.concatenate(
        [trimesh.Trimesh(ball.vertices * size + at, ball.faces, process=False) for size, at in shapes]
    )


@pytest.fixture(scope="module")
def mesh():
    body = figure()
    return np.asarray(body.vertices, np.float32), np.asarray(body.faces)


@pytest.fixture(scope="module")
def network(mesh):
    return network_mesh(*mesh)


def normalised(vertices, network):
    return (vertices - network.center) / network.scale


def test_shape_of_the_result(network):
    count = len(network.vertices)
    assert 1000 <= count <= 4000
    np.testing.assert_allclose(np.abs(network.vertices).max(), 0.5, atol=0.02)
    assert network.vertices.dtype == network.normals.dtype == network.areas.dtype == np.float32
    assert network.faces.max() < count and (network.edges[:, 0] < network.edges[:, 1]).all()
    assert len(np.unique(network.edges, axis=0)) == len(network.edges)
    assert np.linalg.norm(network.normals, axis=1).max() < 1.0001
    assert np.median(np.linalg.norm(network.normals, axis=1)) > 0.95
    assert network.components.max() == 6
    assert mesh_parts(network.edges, count).max() == 0  # bridges make it one


def test_push_and_pull_of_smooth_functions(mesh, network):
    points = normalised(mesh[0], network)
    assert np.abs(network.push(smooth(network.vertices)) - smooth(points)).max() < 0.03
    assert np.abs(network.pull(smooth(points)) - smooth(network.vertices)).max() < 0.01
    distance = np.linalg.norm(network.push(network.vertices) - points, axis=1)
    assert np.median(distance) < 0.003 and distance.max() < 0.02


def test_parts_do_not_leak_into_each_other(mesh, network):
    """Where loose parts touch or overlap, each vertex takes its values from its own part."""
    part = np.repeat(np.arange(7), len(mesh[0]) // 7)
    marks = np.eye(7)[part]
    pulled = network.pull(marks)
    np.testing.assert_allclose(pulled.max(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(network.push(pulled), marks, atol=1e-5)


def test_reordering_moves_nothing(mesh, network):
    vertices, faces = mesh
    rng = np.random.default_rng(0)
    order = rng.permutation(len(vertices))
    again = network_mesh(vertices[order], np.roll(np.argsort(order)[faces][rng.permutation(len(faces))], 1, axis=1))
    for name in ("vertices", "normals", "areas", "faces", "edges", "components"):
        np.testing.assert_array_equal(getattr(again, name), getattr(network, name))
    np.testing.assert_array_equal(again.push(smooth(again.vertices)), network.push(smooth(network.vertices))[order])


def test_opened_seams_move_nothing(mesh, network):
    vertices, faces = mesh
    soup = network_mesh(vertices[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3))
    np.testing.assert_array_equal(soup.vertices, network.vertices)
    np.testing.assert_array_equal(soup.edges, network.edges)
    np.testing.assert_array_equal(
        soup.push(smooth(soup.vertices)), network.push(smooth(network.vertices))[faces.reshape(-1)]
    )


def test_finer_tessellation_of_the_same_surface(mesh, network):
    """Every face split in four: the vertices that both have get nearly the same values."""
    fine = trimesh.Trimesh(*mesh, process=False).subdivide()
    again = network_mesh(fine.vertices, fine.faces)
    assert abs(len(again.vertices) / len(network.vertices) - 1) < 0.05
    change = np.abs(again.push(smooth(again.vertices))[: len(mesh[0])] - network.push(smooth(network.vertices)))
    assert change.mean() < 2e-3 and change.max() < 0.03


def grid_cylinder(around: int):
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    here, there = np.arange(around), (np.arange(around) + 1) % around
    faces = np.concatenate(
        [np.stack([here, there, here + around], 1), np.stack([there, there + around, here + around], 1)]
    )
    return np.concatenate([ring, ring + [0, 3, 0]]), faces


def loose_triangles(count: int, size: float):
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def giant_and_tiny():
    ball = trimesh.creation.icosphere(4, radius=0.01)
    count = len(ball.vertices)
    return np.concatenate([ball.vertices, [[-5, -5, 0], [5, -5, 0], [0, 8, 0]]]), np.concatenate(
        [ball.faces, [[count, count + 1, count + 2]]]
    )


ZOO = {
    "triangle": (np.eye(3), np.array([[0, 1, 2]])),
    "plane": (np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])),
    "box": (trimesh.creation.box().vertices, trimesh.creation.box().faces),
    "collinear": (
        np.stack([np.linspace(0, 1, 50)] + [np.zeros(50)] * 2, 1),
        np.stack([np.arange(48), np.arange(1, 49), np.arange(2, 50)], 1),
    ),
    "needles": grid_cylinder(20_000),
    "3,000 loose triangles": loose_triangles(3000, 0.02),
    "5,000 long loose triangles": loose_triangles(5000, 0.4),
    "random faces": (
        np.random.default_rng(0).normal(size=(500, 3)),
        np.random.default_rng(1).integers(0, 500, (2000, 3)),
    ),
    "giant and tiny": giant_and_tiny(),
}


@pytest.mark.parametrize("name", ZOO)
def test_zoo(name):
    vertices, faces = ZOO[name]
    network = network_mesh(vertices, faces)
    count = len(network.vertices)
    assert 1000 <= count <= 4000
    assert mesh_parts(network.edges, count).max() == 0
    for values in (network.vertices, network.normals, network.areas):
        assert np.isfinite(values).all()
    pushed = network.push(np.eye(count, 5) + 1)
    assert pushed.shape == (len(vertices), 5) and np.isfinite(pushed).all()
    np.testing.assert_allclose(network.push(np.ones((count, 1))), 1, atol=1e-5)
    np.testing.assert_allclose(network.pull(np.ones((len(vertices), 1))), 1, atol=1e-5)


def test_stray_and_nan_vertices_get_values(mesh):
    vertices = np.concatenate([mesh[0], [[0, 9, 0], [np.nan, 0, 0]]])
    network = network_mesh(vertices, mesh[1])
    assert np.isfinite(network.push(network.vertices)).all()
    values = np.zeros((len(vertices), 1))
    values[-2:] = 1e6
    assert network.pull(values).max() == 0  # vertices without faces have no say


def test_a_broken_mesh_is_refused():
    with pytest.raises(CharacterError, match="not numbers"):
        network_mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
    with pytest.raises(CharacterError, match="100 vertices"):
        network_mesh(np.eye(3), np.array([[0, 1, 2]]), max_vertices=10)


def test_a_very_fine_mesh_becomes_what_a_fine_one_does():
    """Above so many vertices a mesh is merged in a finer grid first, and nothing else may come of it."""
    coarse, fine = (network_mesh(*_grown_sphere(rings), 1000) for rings in (120, 300))
    assert len(fine.clean.vertices) > 60_000 > len(coarse.clean.vertices)
    assert len(fine.surface.vertices) < 60_000
    assert 0.9 < len(fine.vertices) / len(coarse.vertices) < 1.1
    assert np.abs(np.linalg.norm(fine.vertices, axis=1) - 0.5).max() < 0.01
    np.testing.assert_allclose(fine.areas.sum(), coarse.areas.sum(), rtol=5e-3)
    places = fine.push(fine.vertices)
    assert np.abs(places - (_grown_sphere(300)[0] - fine.center) / fine.scale).max() < 0.03


def _grown_sphere(rings):
    """A sphere of so many rings of as many vertices, and its triangles."""
    up, around = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, rings), np.arange(rings) * 2 * np.pi / rings, indexing="ij"
    )
    points = np.stack([np.sin(up) * np.cos(around), np.cos(up), np.sin(up) * np.sin(around)], axis=-1).reshape(-1, 3)
    a = np.arange(rings * (rings - 1)).reshape(rings - 1, rings)
    b = np.roll(a, -1, axis=1)
    quads = np.stack([a, b, b + rings, a + rings], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
