"""The joint refinement: its features, its formula and its losses by hand."""

import math

import numpy as np
import pytest
import torch

from bunraku.apparel.clothed import SIZE, ClothedCharacter
from bunraku.body.layout import JOINT_COUNT
from bunraku.errors import WeightsError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.training.apparel.networks.refinement import (
    FREE,
    RefinementConfig,
    RefinementNetwork,
    load_refinement,
    refined,
    save_refinement,
)
from bunraku_lab.training.apparel.networks.seam import BASIS, HOPS, INPUTS, seam_of
from bunraku_lab.training.losses.apparel_losses import edge_loss, refinement_loss, vertex_loss

ROWS = 41


def banner():
    """A strip of squares of 5 cm, 2 m high, whose lower half is apparel; one vertex stands twice, as at a seam of its
    texture.
    """
    down = np.linspace(2.0, 0.0, ROWS)
    points = np.concatenate([np.stack([np.full(ROWS, x), down, np.zeros(ROWS)], axis=1) for x in (0.0, 0.05)])
    top = np.arange(ROWS - 1)
    faces = np.concatenate([
        np.stack([top, top + 1, top + ROWS], axis=1), np.stack([top + 1, top + ROWS + 1, top + ROWS], axis=1),
    ])  # fmt: skip
    twin = len(points)
    points = np.concatenate([points, points[:1]])
    faces[0, 0] = twin
    apparel = points[:, 1] < 0.99
    weights = np.zeros((len(points), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    return ClothedCharacter(
        points.astype(np.float32), faces, np.zeros((JOINT_COUNT, 3)), weights, apparel, np.where(apparel, 0, -1),
        np.array([-1.0], np.float32), np.array([0.9], np.float32),
    )  # fmt: skip


def standing():
    return np.tile(np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1), (JOINT_COUNT, 1, 1))


def test_the_seam_reaches_a_little_into_the_body():
    clothed = banner()
    seam = seam_of(clothed, clothed.weights)
    heights = clothed.rest[seam.vertices, 1]
    # the highest apparel is at 0.95 m; 12 cm at a size of 2 / 1.6 are 15 cm, a hair less than three rows of the body
    assert heights.max() == pytest.approx(1.05) and heights.min() == 0
    assert len(seam.vertices) == 2 * 22
    assert np.allclose(seam.around.sum(axis=1), 1, atol=1e-6)
    assert seam.still[:, 0].tolist() == (heights < 0.99).astype(float).tolist()
    bare = seam_of(ClothedCharacter(clothed.rest, clothed.faces, clothed.joints, clothed.weights,
        np.zeros(len(clothed.rest), bool),
                          np.full(len(clothed.rest), -1), np.zeros(0), np.zeros(0)), clothed.weights)  # fmt: skip
    assert len(bare.vertices) == 0
    network = RefinementNetwork()
    np.testing.assert_array_equal(refined(network, bare, clothed.rest, standing()), clothed.rest)


def test_features_of_a_pulled_vertex_by_hand():
    clothed = banner()
    seam = seam_of(clothed, clothed.weights)
    vertex = 30  # of the left edge, in the apparel
    row = int(np.flatnonzero(seam.vertices == vertex)[0])
    positions = clothed.rest.copy()
    positions[vertex, 2] += 0.04
    frame = seam.frame(positions, standing())
    assert frame.vectors.shape == (len(seam.vertices), BASIS, 3) and frame.inputs.shape[1] == INPUTS
    near = np.unique(seam.edges[(seam.edges == row).any(axis=1)])
    size = 2 / SIZE
    # the mean of the vertex and its neighbours lies back by all of the way but its own share
    assert frame.vectors[row, 0, 2] == pytest.approx(-0.04 * (1 - 1 / len(near)) / size, rel=1e-4)
    assert frame.vectors[row, len(HOPS) + 1, 2] == pytest.approx(-0.04 / size, rel=1e-4)
    # each edge to it is too long by a known length, and half of that along the edge would even it out
    pulled = []
    for other in near[near != row]:
        length = float(np.linalg.norm(clothed.rest[seam.vertices[other]] - clothed.rest[vertex]))
        now = math.hypot(length, 0.04)
        pulled.append(-0.5 * (now - length) * 0.04 / now)
    assert frame.vectors[row, len(HOPS), 2] == pytest.approx(np.mean(pulled) / size, rel=1e-3)
    still = seam.frame(clothed.rest, standing())
    assert np.abs(still.vectors).max() < 1e-6


def test_features_turn_with_the_body():
    clothed = banner()
    seam = seam_of(clothed, clothed.weights)
    random = np.random.default_rng(0)
    positions = clothed.rest + random.normal(0, 0.01, clothed.rest.shape).astype(np.float32)
    turn = matrix_from_axis_angle(np.array([0.3, -1.0, 0.5]))
    moved = standing()
    moved[:, :, :3], moved[:, :, 3] = turn, [1.0, 2.0, 3.0]
    one, other = seam.frame(positions, standing()), seam.frame(positions @ turn.T + [1.0, 2.0, 3.0], moved)
    np.testing.assert_allclose(other.vectors, one.vectors, atol=2e-6)


def test_the_refinement_is_added_to_both_results():
    """With a decoder that says nothing but its bias: half of the way to the mean around, and a step along x."""
    clothed = banner()
    seam = seam_of(clothed, clothed.weights)
    network = RefinementNetwork(RefinementConfig(4))
    np.testing.assert_array_equal(refined(network, seam, clothed.rest, standing()), clothed.rest)
    with torch.no_grad():
        network.layers[-1].bias[0] = math.atanh(0.5)
        network.layers[-1].bias[BASIS] = math.atanh(0.25)
    positions = clothed.rest.copy()
    positions[30, 2] += 0.04
    out = refined(network, seam, positions, standing())
    size = 2 / SIZE
    row = int(np.flatnonzero(seam.vertices == 30)[0])
    frame = seam.frame(positions, standing())
    assert out[30, 2] == pytest.approx(positions[30, 2] + 0.5 * frame.vectors[row, 0, 2] * size, rel=1e-4)
    assert out[30, 0] == pytest.approx(positions[30, 0] + 0.25 * FREE * size, rel=1e-4)
    far = clothed.rest[:, 1] > 1.2
    np.testing.assert_array_equal(out[far], positions[far])  # of the body away from the seam nothing moves


def test_twins_go_together():
    clothed = banner()
    whole = ClothedCharacter(clothed.rest, clothed.faces, clothed.joints, clothed.weights,
        np.ones(len(clothed.rest), bool),
                   np.zeros(len(clothed.rest), np.int64), clothed.stiffness, clothed.damping)  # fmt: skip
    seam = seam_of(whole, whole.weights)
    network = RefinementNetwork(RefinementConfig(4))
    torch.manual_seed(0)
    torch.nn.init.normal_(network.layers[-1].weight)
    positions = clothed.rest.copy()
    positions[[0, -1], 2] += 0.03  # the same place twice
    out = refined(network, seam, positions, standing())
    np.testing.assert_array_equal(out[0], out[-1])
    assert np.abs(out - positions).max() > 1e-4


def test_its_losses_by_hand():
    change = torch.tensor([[3.0, 0, 4.0], [0, 1.0, 0]])
    assert refinement_loss(change) == pytest.approx(13.0)
    points, truth = torch.tensor([[0.0, 0, 0], [0, 3, 0]]), torch.tensor([[0.0, 0, 1], [0, 2, 1]])
    assert vertex_loss(points, truth) == pytest.approx(1.5)
    assert edge_loss(points, truth, torch.tensor([[0, 1]])) == pytest.approx(1.0)


def test_a_checkpoint_of_another_kind_is_not_read(tmp_path):
    network = RefinementNetwork(RefinementConfig(4))
    path = save_refinement(tmp_path / "a.safetensors", network)
    assert load_refinement(path).config.width == 4
    with pytest.raises(WeightsError):
        load_refinement(tmp_path / "b.safetensors")
