"""The layers of Skeleton-free Pose Transfer against values computed by hand."""

import numpy as np
import pytest
import torch

from bunraku_lab.nn.baselines.part_graph import GraphUnit, Norm, part_graph, per_mesh_max, shares_of
from bunraku_lab.nn.baselines.pose_transfer import (
    TransferConfig,
    TransferNetwork,
    affine_of,
    load_transfer,
    part_centres,
    save_transfer,
)

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32)
EDGES = np.array([[0, 1], [1, 2]])
SMALL = TransferConfig(parts=2, levels=(4, 5), code=6)


def graph(copies=1):
    return part_graph([(POINTS + copy, np.ones((3, 3), np.float32), EDGES) for copy in range(copies)])


def test_a_graph_unit_as_its_definition_reads():
    """The largest message over the one-ring and the vertex itself, one edge at a time; two meshes do not hear of one
    another.
    """
    torch.manual_seed(0)
    unit = GraphUnit(6, 5).eval()
    block, x = graph(2), torch.rand(6, 6)
    rings = {0: [0, 1], 1: [1, 0, 2], 2: [2, 1]}
    for vertex in range(6):
        first, own = 3 * (vertex // 3), vertex % 3
        said = []
        for other in rings[own]:
            linear = unit.own(x[vertex]) + unit.other(x[first + other] - x[vertex])
            said.append(unit.message(unit.norm(torch.relu(linear)[None]))[0])
        wanted = unit.after(torch.stack(said).amax(0)[None])[0]
        torch.testing.assert_close(unit(x, block)[vertex], wanted)


def test_norms_follow_the_batches_with_a_tenth():
    norm, x = Norm(1).train(), torch.tensor([[1.0], [3.0]])
    found = norm(x)
    assert found[:, 0].tolist() == pytest.approx([-1, 1], abs=1e-4)
    assert float(norm.running_mean) == pytest.approx(0.1 * 2) and float(norm.running_var) == pytest.approx(
        0.9 + 0.1 * 2
    )
    assert float(norm.eval()(x)[0].detach()) == pytest.approx((1 - 0.2) / 1.1**0.5, abs=1e-4)


def test_the_largest_of_each_mesh_and_shares_of_parts():
    x = torch.tensor([[1.0, 5], [3, 2], [9, 0]])
    assert per_mesh_max(x, (2, 1)).tolist() == [[3, 5], [3, 5], [9, 0]]
    first, second = shares_of(torch.tensor([[1.0, 0], [3, 0], [0.5, 0.5]]), (2, 1))
    assert first.tolist() == [[0.25, 0], [0.75, 0]] and second.tolist() == [[1, 1]]  # a part without weight keeps none


def test_a_part_s_code_is_that_of_its_vertices():
    """With parts that do not overlap, a code changes with its own part's weights alone."""
    torch.manual_seed(0)
    encoder = TransferNetwork(SMALL).encoder.eval()
    weights = torch.tensor([[1.0, 0], [0, 1], [0, 1]])
    codes = encoder(graph(), weights)
    other = encoder(graph(), torch.tensor([[1.0, 0], [0, 1], [0, 0.5]]))
    assert codes.shape == (1, 2, 6)
    torch.testing.assert_close(other[0, 0], codes[0, 0])
    assert not torch.allclose(other[0, 1], codes[0, 1])


def test_centres_and_transforms_by_hand():
    centres = part_centres(torch.from_numpy(POINTS), torch.tensor([[1.0, 0], [0, 1], [0, 1]]))
    assert centres.tolist() == [[0, 0, 0], [0.5, 1, 0]]
    quarter = [0.0, 0, 3, 0.5**0.5, 0, 0, 0.5**0.5]  # a quarter turn about z, w first, and 3 forward
    affine = affine_of(torch.tensor([0.5, 1, 0]), torch.tensor(quarter))
    moved = affine[:, :3] @ torch.tensor([1.5, 1, 0]) + affine[:, 3]
    assert moved.tolist() == pytest.approx([0.5, 2, 3], abs=1e-6)


def test_untrained_it_moves_parts_as_the_source_s():
    torch.manual_seed(0)
    network = TransferNetwork(SMALL).eval()
    own = torch.tensor([[[0.1, 0.2, 0.3, 1.0, 0, 0, 0], [0, 0, 0, 0.8, 0.6, 0, 0]]])
    weights = torch.tensor([[1.0, 0], [0.5, 0.5], [0, 1]])
    said = network(graph(), graph(), graph(), (weights, weights), own)
    torch.testing.assert_close(said, own, atol=0.02, rtol=0)
    torch.testing.assert_close(said[..., 3:].norm(dim=2), torch.ones(1, 2))


def test_poses_of_one_source_for_one_target_are_those_one_by_one():
    torch.manual_seed(0)
    network = TransferNetwork(SMALL).eval()
    weights = torch.tensor([[1.0, 0], [0.5, 0.5], [0, 1]])
    own = torch.nn.functional.normalize(torch.rand(2, 2, 7), dim=2)
    poses = graph(2)
    both = network(graph(), poses, graph(), (weights, weights), own)
    first = network(graph(), graph(), graph(), (weights, weights), own[:1])
    torch.testing.assert_close(both[:1], first)


def test_networks_come_back_from_their_files(tmp_path):
    for config in (SMALL, TransferConfig(parts=3, predictor=True, tied=2, levels=(4, 5), code=6)):
        torch.manual_seed(0)
        network = TransferNetwork(config).eval()
        again = load_transfer(save_transfer(tmp_path / "transfer.safetensors", network))
        assert again.config == config
        if config.predictor:
            found = again.weights(graph())
            assert torch.equal(found, network.weights(graph())) and found.shape == (3, 3)
            torch.testing.assert_close(found.sum(dim=1), torch.ones(3))
