import numpy as np
import pytest

from bunraku_lab.datasets.characters.training_character import TrainingMesh
from bunraku_lab.training.handles.mesh_augmentation import (
    MeshAugmentation,
    augment_mesh,
    coarser,
    noisy,
    pierced,
    slid,
    split,
)


@pytest.fixture
def mesh() -> TrainingMesh:
    """A strip of two rows of vertices whose labels and poses are linear in x, so that any mean of rows must stay on the
    line.
    """
    count = 40
    x = np.repeat(np.linspace(-0.5, 0.5, count // 2), 2)
    vertices = np.stack([x, np.tile([0.0, 0.05], count // 2), 0 * x], axis=1).astype(np.float32)
    edges = np.array([(i, i + 1) for i in range(0, count, 2)] + [(i, i + 2) for i in range(count - 2)])
    weights = np.stack([0.5 + x, 0.5 - x], axis=1).astype(np.float32)
    target = np.zeros((count, 30), np.float32)
    target[:, 3:5] = weights
    return TrainingMesh(
        vertices=vertices, normals=np.tile(np.float32([0, 0, 1]), (count, 1)), areas=np.full(count, 0.1, np.float32),
        edges=edges, weights=weights,
        handles=np.array([3, 4]), target=target, root=np.zeros(3, np.float32), height=0.05,
        posed=np.stack([2 * vertices, vertices + 1]),
    )  # fmt: skip


def check(mesh: TrainingMesh) -> None:
    np.testing.assert_allclose(mesh.weights[:, 0], 0.5 + mesh.vertices[:, 0], atol=1e-6)
    np.testing.assert_allclose(mesh.target[:, 4], mesh.weights[:, 1], atol=1e-6)
    np.testing.assert_allclose(mesh.posed[0], 2 * mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(mesh.posed[1], mesh.vertices + 1, atol=1e-6)
    assert mesh.edges.max() < len(mesh.vertices) and (mesh.edges[:, 0] != mesh.edges[:, 1]).all()


def test_slid_vertices_stay_on_their_edges_with_their_labels(mesh):
    out = slid(mesh, np.random.default_rng(0), 0.4)
    check(out)
    step = np.linalg.norm(out.vertices - mesh.vertices, axis=1)
    assert step.max() > 0.005 and step.max() <= 0.4 * 0.0527


def test_coarser_keeps_the_area_and_the_labels(mesh):
    out = coarser(mesh, np.random.default_rng(0), 0.5)
    check(out)
    assert len(out.vertices) < 0.8 * len(mesh.vertices)
    assert out.areas.sum() == pytest.approx(mesh.areas.sum(), rel=1e-5)
    assert len(np.unique(out.edges, axis=0)) == len(out.edges)


def test_pierced_leaves_out_balls_and_renumbers(mesh):
    out = pierced(mesh, np.random.default_rng(1), 0.04)
    check(out)
    assert 0.9 * len(mesh.vertices) <= len(out.vertices) < len(mesh.vertices)


def test_split_cuts_between_parts_alone(mesh):
    out = split(mesh, np.random.default_rng(2))
    check(out)
    kept = {tuple(edge) for edge in out.edges}
    lost = np.array([edge for edge in mesh.edges if tuple(edge) not in kept])
    assert 0 < len(lost) < 0.3 * len(mesh.edges)


def test_damage_is_random_but_repeatable(mesh):
    always = MeshAugmentation(slide_rate=1, coarse_rate=1, hole_rate=1, split_rate=1, noise=0)
    first, second = (augment_mesh(mesh, np.random.default_rng(5), always) for _ in range(2))
    check(first)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert augment_mesh(mesh, np.random.default_rng(5), MeshAugmentation(0, 0, 0, 0, 0, 0, 0, 0, 0)) is mesh


def test_noise_is_the_same_in_all_poses(mesh):
    out = noisy(mesh, np.random.default_rng(3), 0.01, 0.1)
    np.testing.assert_allclose(
        out.posed - mesh.posed, np.broadcast_to(out.vertices - mesh.vertices, mesh.posed.shape), atol=1e-6
    )
    assert 0.007 < (out.vertices - mesh.vertices).std() < 0.013 and 0.07 < (out.normals - mesh.normals).std() < 0.13
