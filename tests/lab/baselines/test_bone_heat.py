import numpy as np
import trimesh

from bunraku.body.reference import reference_body
from bunraku_lab.baselines.bone_heat import bone_distances, bone_heat, cotangent_laplacian, embedded_bone_heat
from bunraku_lab.baselines.volume import volume_of


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


def test_distances_to_bones_by_hand():
    distance, nearest = bone_distances(np.array([[0.5, 1.0, 0], [3, 0, 4]]), np.zeros((1, 3)), np.array([[1.0, 0, 0]]))
    np.testing.assert_allclose(distance[:, 0], [1, np.sqrt(20)])
    np.testing.assert_allclose(nearest[:, 0], [[0.5, 0, 0], [1, 0, 0]])


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


def test_bones_of_one_joint_are_one_source():
    mesh = cylinder()
    starts, ends = np.concatenate([BONES[0], BONES[0][1:]]), np.concatenate([BONES[1], BONES[1][1:]])
    twice = bone_heat(mesh.vertices, mesh.faces, starts, ends, [0, 1, 1])
    np.testing.assert_allclose(twice, bone_heat(mesh.vertices, mesh.faces, *BONES, [0, 1]), atol=1e-6)


def test_the_body_gets_the_parts_of_a_body():
    body = reference_body()
    weights = embedded_bone_heat(body.vertices, body.faces)
    assert weights.shape == (len(body.vertices), 22)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert (weights.argmax(axis=1) == body.joint_weights.argmax(axis=1)).mean() > 0.7
