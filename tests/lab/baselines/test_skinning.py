"""Skinning without learning: clusters, an embedded skeleton, bone heat."""

import numpy as np
import pytest
import trimesh
from scipy.sparse.csgraph import connected_components

from bunraku.core.body.reference import reference_body
from bunraku_lab.baselines.skinning import (
    Template,
    bone_heat,
    cluster_vertices,
    cotangent_laplacian,
    embed_skeleton,
    embedded_bone_heat,
    embedded_human,
    geodesic_clusters,
    geodesic_graph,
    volume_of,
)


def test_clusters_are_connected_and_not_empty():
    ball = trimesh.creation.icosphere(4)
    graph = geodesic_graph(ball.vertices, ball.faces)
    label, medoids = cluster_vertices(graph, ball.vertices, np.ones(len(ball.vertices)), 30)
    assert len(medoids) == 30
    sizes = np.bincount(label, minlength=30)
    assert sizes.min() > 0 and sizes.max() < 4 * sizes.mean()
    for cluster in range(30):
        members = np.flatnonzero(label == cluster)
        assert connected_components(graph[members][:, members], directed=False)[0] == 1
        assert medoids[cluster] in members


def test_clusters_do_not_jump_over_gaps():
    """Two bars that almost touch: near in space, far along the surface."""
    left = trimesh.creation.box((0.2, 2, 0.2)).subdivide().subdivide().subdivide()
    right = left.copy().apply_translation([0.21, 0, 0])
    foot = trimesh.creation.box((0.41, 0.2, 0.2)).apply_translation([0.105, -1.1, 0])
    whole = trimesh.util.concatenate([left, right, foot])
    weights = geodesic_clusters(whole.vertices, whole.faces, 8)
    side = (np.arange(len(whole.vertices)) >= len(left.vertices)).astype(int)
    upper = whole.vertices[:, 1] > 0.3
    assert not set(weights[upper & (side == 0)].argmax(1)) & set(weights[upper & (side == 1)].argmax(1))


def test_the_volume_of_a_ball_is_its_depth():
    ball = trimesh.creation.icosphere(4, 0.5)
    volume = volume_of(ball.vertices, ball.faces, 32)
    points = np.array([[0, 0, 0], [0.2, 0.1, 0], [0, 0.53, 0]])
    np.testing.assert_allclose(volume.at(points), 0.5 - np.linalg.norm(points, axis=1), atol=0.02)
    least = volume.shallowest(np.array([-0.3, 0.0, 0]), np.array([0.42, 0.0, 0]), 11)
    np.testing.assert_allclose(least, 0.5 - 0.36, atol=0.03)  # the last of 11 places


def test_a_chain_finds_its_place_in_a_bent_pipe():
    """Three points of a template that is straight go to the ends and the bend of an L, the only way to keep the bones'
    lengths inside.
    """
    upright = trimesh.creation.box((0.12, 1, 0.12)).apply_translation([0, 0.5, 0])
    across = trimesh.creation.box((0.6, 0.12, 0.12)).apply_translation([0.3, 0.94, 0])
    whole = (
        trimesh.boolean.union([upright, across])
        if trimesh.boolean.engines_available
        else trimesh.util.concatenate([upright, across])
    )
    volume = volume_of(whole.vertices, whole.faces)
    template = Template(
        np.array([[0, 0.05, 0], [0, 0.9, 0], [0.5, 0.95, 0]]), np.array([-1, 0, 1]), np.array([0, 0, 1]), 3, lean=1.0
    )
    found = embed_skeleton(template, volume, whole.vertices.min(0), whole.vertices.max(0))
    np.testing.assert_allclose(found.points, template.points, atol=0.12)
    assert found.bones() == [(0, 1), (1, 2)]


@pytest.mark.parametrize("shape", ["average", "child"])
def test_the_joints_of_the_body_are_found(shape):
    body = reference_body(shape)
    skeleton, volume = embedded_human(body.vertices, body.faces)
    height = np.ptp(body.vertices[:, 1])
    off = np.linalg.norm(skeleton.points[:22] - body.joints, axis=1) / height
    assert off.mean() < 0.06 and off.max() < 0.15
    assert (volume.at(skeleton.points) > -0.02 * height).mean() > 0.9


def cylinder() -> trimesh.Trimesh:
    """Along X from -0.5 to 0.5, in rings."""
    rings, sides = 41, 24
    angle = np.arange(sides) * 2 * np.pi / sides
    x = np.repeat(np.linspace(-0.5, 0.5, rings), sides)
    vertices = np.stack([x, 0.08 * np.tile(np.cos(angle), rings), 0.08 * np.tile(np.sin(angle), rings)], axis=1)
    here = np.arange(sides)
    faces = []
    for ring in range(rings - 1):
        a, b = ring * sides + here, ring * sides + (here + 1) % sides
        faces += [np.stack([a, b, a + sides], 1), np.stack([b, b + sides, a + sides], 1)]
    caps = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    first, last = np.full(sides, len(vertices)), np.full(sides, len(vertices) + 1)
    end = (rings - 1) * sides
    faces += [np.stack([(here + 1) % sides, here, first], 1), np.stack([end + here, end + (here + 1) % sides, last], 1)]
    return trimesh.Trimesh(np.concatenate([vertices, caps]), np.concatenate(faces), process=False)


BONES = np.array([[-0.45, 0, 0], [0.0, 0, 0]]), np.array([[0.0, 0, 0], [0.45, 0, 0]])


def test_the_laplacian_is_that_of_a_grid():
    """On right triangles of a unit grid the cotangent weights are 1 along the sides and 0 along the diagonals."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    points = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    a = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    faces = np.concatenate([np.stack([a, a + 4, a + 5], 1), np.stack([a, a + 5, a + 1], 1)])
    matrix = cotangent_laplacian(points, faces).toarray()
    np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-9)
    np.testing.assert_allclose(matrix[5, [1, 9, 4, 6, 5]], [-1, -1, -1, -1, 4], atol=1e-4)


def test_two_bones_share_a_cylinder():
    mesh = cylinder()
    weights = bone_heat(mesh.vertices, mesh.faces, *BONES, [0, 1], volume_of(mesh.vertices, mesh.faces))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert weights.min() >= 0
    rings = weights[: 41 * 24, 1].reshape(41, 24)
    assert (np.diff(rings.mean(axis=1)) > -1e-6).all()  # rises from one end to the other
    assert rings.std(axis=1).max() < 0.02
    # Both bones are one radius away, so the heat equation in one dimension, w'' = (w - p) c / r^2, has a closed
    # solution.
    length, x = 0.08 / np.sqrt(0.22), np.linspace(-0.5, 0.0, 21)
    np.testing.assert_allclose(
        rings[:21].mean(axis=1), np.cosh((x + 0.5) / length) / np.cosh(0.5 / length) / 2, atol=0.02
    )


def test_a_hidden_bone_gives_no_heat():
    """A bone of another bar, nearer than the own one but across a gap."""
    left = trimesh.creation.box((0.1, 1, 0.1)).subdivide().subdivide().subdivide()
    right = left.copy().apply_translation([0.2, 0, 0])
    both = trimesh.util.concatenate([left, right])
    starts, ends = np.array([[0, 0.3, 0], [0.2, -0.4, 0]]), np.array([[0, 0.45, 0], [0.2, 0.4, 0]])
    seen = bone_heat(both.vertices, both.faces, starts, ends, [0, 1], volume_of(both.vertices, both.faces))
    blind = bone_heat(both.vertices, both.faces, starts, ends, [0, 1])
    low = (both.vertices[:, 0] < 0.1) & (both.vertices[:, 1] < -0.2)
    assert seen[low, 0].mean() > 2 * blind[low, 0].mean() > 0  # what the other bone has there came over the bridges


def test_the_body_gets_the_parts_of_a_body():
    body = reference_body()
    weights = embedded_bone_heat(body.vertices, body.faces)
    assert weights.shape == (len(body.vertices), 22)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert (weights.argmax(axis=1) == body.joint_weights.argmax(axis=1)).mean() > 0.7
