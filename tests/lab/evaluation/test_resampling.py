import numpy as np
import pytest
import trimesh

from bunraku.core.character import Character
from bunraku.samples import sample_character
from bunraku_lab.evaluation.handles.resampling import carried, resampled


@pytest.mark.parametrize("count", [1_000, 5_000, 50_000])
def test_the_surface_stays_and_the_vertices_are_as_many(count):
    dog = sample_character("dog")
    other = resampled(dog, count)
    assert 0.9 * count < len(other.vertices) < 1.15 * count
    np.testing.assert_allclose(np.ptp(other.vertices, axis=0), np.ptp(dog.vertices, axis=0), rtol=0.03)
    tree = trimesh.Trimesh(dog.vertices, dog.faces, process=False)
    _, distance, _ = trimesh.proximity.closest_point_naive(tree, other.vertices[:: max(1, count // 50)])
    assert distance.max() < 0.02 * dog.height


def test_a_coarse_mesh_is_refined_evenly_whatever_its_triangles():
    box = trimesh.creation.box((1, 1, 1))
    for count in (1_000, 5_000):
        got = resampled(Character("box", box.vertices, box.faces), count)
        assert (
            0.6 * count < len(got.vertices) < 1.6 * count
        )  # all edges are as long: they are split together or not at all
        assert trimesh.Trimesh(got.vertices, got.faces, process=False).is_watertight


def test_linear_values_are_carried_exactly():
    ball = trimesh.creation.icosphere(3)
    points = ball.triangles_center
    got = carried(ball.vertices, ball.vertices, ball.faces, points * 1.001)
    np.testing.assert_allclose(got, points, atol=1e-3)
    np.testing.assert_allclose(
        carried(np.eye(len(ball.vertices)), ball.vertices, ball.faces, ball.vertices).argmax(1),
        np.arange(len(ball.vertices)),
    )
