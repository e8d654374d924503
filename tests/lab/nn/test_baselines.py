"""The networks of the baselines."""

import numpy as np
import torch

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku_lab.nn.blend_shapes import (
    MeshConv,
    NbsConfig,
    NbsNetwork,
    edge_mesh,
    shape_joints,
)
from bunraku_lab.nn.pose_transfer import (
    GraphUnit,
    TransferConfig,
    TransferNetwork,
    part_graph,
)

FACES = np.array([[0, 1, 2], [0, 2, 3]])  # a square of two triangles
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]])


def test_a_mesh_convolution_by_hand():
    layer = MeshConv(1, 1)
    with torch.no_grad():
        layer.linear.weight.copy_(torch.tensor([[1.0, 10, 100, 1000, 10000]]))
        layer.linear.bias.fill_(0.5)
    x = torch.tensor([[1.0], [2], [4], [8], [16]])
    found = layer(x, edge_mesh(FACES, EDGES, 4)).detach()
    a, b, c, d = 1, 8, 16, 4  # around the diagonal
    assert float(found[1]) == 2 + 10 * (a + c) + 100 * (b + d) + 1000 * abs(a - c) + 10000 * abs(b - d) + 0.5
    assert float(found[0]) == 1 + 10 * 8 + 100 * 2 + 1000 * 8 + 10000 * 2 + 0.5  # with nothing on its other side


def test_which_joints_shapes_a_vertex_takes():
    wrist, elbow = JOINT_NAMES.index("left_wrist"), JOINT_NAMES.index("left_elbow")
    weights = torch.zeros(3, JOINT_COUNT)
    weights[0, elbow], weights[1, wrist], weights[2, 0] = 0.04, 0.03, 1.0
    found = shape_joints(weights)
    assert found[0, wrist] == 1 and found[0, elbow] == 0  # 0.04 is enough for a wrist, by the joint above
    assert found[1, wrist] == 1
    assert found[2].nonzero().flatten().tolist() == [0, *(j for j, up in enumerate(JOINT_PARENTS) if up == 0)]


def test_blend_shapes_are_the_coefficients_times_the_shapes():
    torch.manual_seed(0)
    network = NbsNetwork(NbsConfig(skinning=(4,), geometry=(4, 5), mixed=4, shapes=2))
    assert network.blend is not None
    shapes = torch.tensor([[[1.0, 0, 0], [0, 2, 0]]])
    takes = torch.zeros(1, JOINT_COUNT)
    takes[0, 3] = 1
    turns = torch.eye(3).repeat(1, JOINT_COUNT, 1, 1)
    turns[0, 3] = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    said = network.blend.coefficients[3]((turns[0, 3] - torch.eye(3)).reshape(1, 9))[0].detach()
    moved = network.blend.moved(shapes, takes, turns)[0, 0].detach()
    torch.testing.assert_close(moved, torch.stack([said[0], 2 * said[1], torch.zeros(())]))
    assert float(moved.abs().max()) < 0.01  # a thousandth before it has learned


def test_networks_come_back_from_their_files(tmp_path):
    for config in (NbsConfig(skinning=(4, 5)), NbsConfig(skinning=(4,), geometry=(4,), mixed=3, shapes=2)):
        torch.manual_seed(0)
        network = NbsNetwork(config).eval()
        again = NbsNetwork.load(network.save(tmp_path / "nbs.safetensors"))
        mesh, points = edge_mesh(FACES, EDGES, 4), torch.rand(4, 3)
        assert again.config == config and torch.equal(again(points, mesh), network(points, mesh))
        torch.testing.assert_close(network(points, mesh).sum(dim=1), torch.ones(4))


POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]], np.float32)
PART_EDGES = np.array([[0, 1], [1, 2]])
SMALL = TransferConfig(parts=2, levels=(4, 5), code=6)


def graph(copies=1):
    return part_graph([(POINTS + copy, np.ones((3, 3), np.float32), PART_EDGES) for copy in range(copies)])


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


def test_untrained_it_moves_parts_as_the_source_s():
    torch.manual_seed(0)
    network = TransferNetwork(SMALL).eval()
    own = torch.tensor([[[0.1, 0.2, 0.3, 1.0, 0, 0, 0], [0, 0, 0, 0.8, 0.6, 0, 0]]])
    weights = torch.tensor([[1.0, 0], [0.5, 0.5], [0, 1]])
    said = network(graph(), graph(), graph(), (weights, weights), own)
    torch.testing.assert_close(said, own, atol=0.02, rtol=0)
    torch.testing.assert_close(said[..., 3:].norm(dim=2), torch.ones(1, 2))


def test_transfer_networks_come_back_from_their_files(tmp_path):
    for config in (SMALL, TransferConfig(parts=3, predictor=True, tied=2, levels=(4, 5), code=6)):
        torch.manual_seed(0)
        network = TransferNetwork(config).eval()
        again = TransferNetwork.load(network.save(tmp_path / "transfer.safetensors"))
        assert again.config == config
        if config.predictor:
            found = again.weights(graph())
            assert torch.equal(found, network.weights(graph())) and found.shape == (3, 3)
            torch.testing.assert_close(found.sum(dim=1), torch.ones(3))
