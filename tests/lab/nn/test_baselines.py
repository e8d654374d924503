"""The networks of the baselines."""

import numpy as np
import pytest
import torch

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku_lab.nn.blend_shapes import (
    MeshConv,
    NbsConfig,
    NbsNetwork,
    edge_mesh,
    hinted,
    local_rotations,
    moved_by,
    shape_joints,
    vertex_means,
)
from bunraku_lab.nn.pose_transfer import (
    GraphUnit,
    Norm,
    TransferConfig,
    TransferNetwork,
    affine_of,
    part_centres,
    part_graph,
    per_mesh_max,
    shares_of,
)

FACES = np.array([[0, 1, 2], [0, 2, 3]])  # a square of two triangles
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]])


def test_the_edges_around_an_edge():
    """The diagonal 0-2 has all four sides around it; in (0, 1, 2) the way goes on from 2-0 to 0-1 and 1-2."""
    mesh = edge_mesh(FACES, EDGES, 4)
    names = {tuple(pair): row for row, pair in enumerate(EDGES.tolist())}
    assert mesh.around[names[0, 2]].tolist() == [names[0, 1], names[1, 2], names[2, 3], names[0, 3]]
    none = len(EDGES)
    assert mesh.around[names[0, 1]].tolist() == [names[1, 2], names[0, 2], none, none]  # a border


def test_an_edge_in_no_triangle_and_one_in_three():
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    edges = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [1, 3], [1, 4], [4, 5]])
    mesh = edge_mesh(faces, edges, 6)
    assert mesh.around[0].tolist() == [4, 1, 2, 5]  # the first two triangles alone
    assert mesh.around[7].tolist() == [8, 8, 8, 8]


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


def test_which_triangle_comes_first_does_not_matter():
    layer, x = MeshConv(3, 4), torch.rand(5, 3)
    one, other = (layer(x, edge_mesh(faces, EDGES, 4)) for faces in (FACES, FACES[::-1]))
    torch.testing.assert_close(one, other)


def test_hints_and_vertex_means_by_hand():
    x = torch.tensor([[-1.0, 2, -3, 4, -5], [3, -4, 5, -6, 7]])
    wanted = [[3, 2, -0.6, 4, -1], [3, -0.8, 5, -1.2, 7]]  # LeakyReLU 0.2; the first of five channels is the largest
    torch.testing.assert_close(hinted(x), torch.tensor(wanted))
    means = vertex_means(torch.tensor([[1.0], [2], [4], [8], [16]]), edge_mesh(FACES, EDGES, 5))
    assert means[:, 0].tolist() == pytest.approx([7 / 3, 4.5, 26 / 3, 10, 0])


def test_which_joints_shapes_a_vertex_takes():
    wrist, elbow = JOINT_NAMES.index("left_wrist"), JOINT_NAMES.index("left_elbow")
    weights = torch.zeros(3, JOINT_COUNT)
    weights[0, elbow], weights[1, wrist], weights[2, 0] = 0.04, 0.03, 1.0
    found = shape_joints(weights)
    assert found[0, wrist] == 1 and found[0, elbow] == 0  # 0.04 is enough for a wrist, by the joint above
    assert found[1, wrist] == 1
    assert found[2].nonzero().flatten().tolist() == [0, *(j for j, up in enumerate(JOINT_PARENTS) if up == 0)]


def test_turns_to_the_parent():
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns = torch.eye(3).repeat(1, JOINT_COUNT, 1, 1)
    turns[0, 1], turns[0, 4] = turn, turn @ turn  # left hip, left knee
    found = local_rotations(turns)[0]
    torch.testing.assert_close(found[1], turn)
    torch.testing.assert_close(found[4], turn)
    torch.testing.assert_close(found[7], (turn @ turn).T)  # the ankle is as it was in the world


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


def test_linear_blend_skinning_by_hand():
    affine = torch.zeros(1, 2, 3, 4)
    affine[0, 0, :, :3] = torch.eye(3)
    affine[0, 1, :, :3] = 2 * torch.eye(3)
    affine[0, 1, :, 3] = torch.tensor([0.0, 0, 4])
    moved = moved_by(torch.tensor([[1.0, 2, 3]]), torch.tensor([[0.75, 0.25]]), affine)
    assert moved.tolist() == [[[1.25, 2.5, 4.75]]]


def test_networks_come_back_from_their_files(tmp_path):
    for config in (NbsConfig(skinning=(4, 5)), NbsConfig(skinning=(4,), geometry=(4,), mixed=3, shapes=2)):
        torch.manual_seed(0)
        network = NbsNetwork(config).eval()
        again = NbsNetwork.load(network.save(tmp_path / "nbs.safetensors"))
        mesh, points = edge_mesh(FACES, EDGES, 4), torch.rand(4, 3)
        assert again.config == config and torch.equal(again(points, mesh), network(points, mesh))
        torch.testing.assert_close(network(points, mesh).sum(dim=1), torch.ones(4))


def test_the_paper_size():
    count = sum(value.numel() for value in NbsNetwork().parameters())
    assert 0.2e6 < count < 0.3e6  # 0.26 million with MMDMC's forty joints, of which we have 22


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
