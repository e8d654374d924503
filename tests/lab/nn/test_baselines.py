"""The networks of the baselines."""

import numpy as np
import torch

from bunraku_lab.nn.blend_shapes import MeshConv, NbsConfig, NbsNetwork, edge_mesh
from bunraku_lab.nn.pose_transfer import GraphUnit, TransferConfig, TransferNetwork, part_graph

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


def test_networks_come_back_from_their_files(tmp_path):
    torch.manual_seed(0)
    config = NbsConfig(skinning=(4, 5))
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
    torch.manual_seed(0)
    network = TransferNetwork(SMALL).eval()
    again = TransferNetwork.load(network.save(tmp_path / "transfer.safetensors"))
    assert again.config == SMALL and again.state_dict().keys() == network.state_dict().keys()
