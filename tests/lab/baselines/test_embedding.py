import numpy as np
import pytest
import trimesh

from bunraku.body.reference import reference_body
from bunraku_lab.baselines.embedding import Template, embed_skeleton, embedded_human, human_template, sphere_centres
from bunraku_lab.baselines.volume import surface_samples, volume_of


def test_the_volume_of_a_ball_is_its_depth():
    ball = trimesh.creation.icosphere(4, 0.5)
    volume = volume_of(ball.vertices, ball.faces, 32)
    points = np.array([[0, 0, 0], [0.2, 0.1, 0], [0, 0.53, 0]])
    np.testing.assert_allclose(volume.at(points), 0.5 - np.linalg.norm(points, axis=1), atol=0.02)
    least = volume.shallowest(np.array([-0.3, 0.0, 0]), np.array([0.42, 0.0, 0]), 11)
    np.testing.assert_allclose(least, 0.5 - 0.36, atol=0.03)  # the last of 11 places


def test_samples_are_spread_by_area():
    box = trimesh.creation.box((1, 2, 4))
    points = surface_samples(box.vertices, box.faces, 14_000)
    on_large = np.abs(np.abs(points[:, 0]) - 0.5) < 1e-9
    assert on_large.mean() == pytest.approx(16 / 28, abs=0.02)


def test_spheres_are_inside_and_apart():
    body = reference_body()
    volume = volume_of(body.vertices, body.faces)
    centres, radii = sphere_centres(volume)
    assert (volume.at(centres) > 0).all() and (np.diff(radii) <= 1e-12).all()
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    assert (
        gaps[np.triu_indices(len(centres), 1)]
        > np.broadcast_to(radii[:, None], gaps.shape)[np.triu_indices(len(centres), 1)] * 0.999
    ).all()


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


def test_the_template_is_a_tree_of_height_one():
    template = human_template()
    assert template.joints == 22 and len(template.points) == 27
    assert (template.parents[1:] < np.arange(1, 27)).all() and template.parents[0] == -1
    assert 0.9 < np.ptp(template.points[:, 1]) <= 1 and np.isfinite(template.points).all()
    left = template.points[template.sides > 0]
    right = template.points[template.sides < 0]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=0.02)
