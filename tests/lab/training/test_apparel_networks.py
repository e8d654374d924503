"""The body network and the joint refinement."""

import math

import numpy as np
import pytest
import torch
from scipy.sparse.csgraph import dijkstra

from bunraku.apparel.clothed import SIZE, ClothedCharacter
from bunraku.apparel.nodes import apparel_parts
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.nn.graph import node_graph
from bunraku_lab.training.apparel.body import BodyConfig, BodyNetwork
from bunraku_lab.training.apparel.meshes import joint_distances, sampled_mesh
from bunraku_lab.training.apparel.refinement import BASIS, FREE, RefinementConfig, RefinementNetwork, refined, seam_of
from bunraku_lab.training.losses.motion import edge_loss, mask_loss, smoothness_loss, vertex_loss


def test_the_attention_map_by_hand():
    """Before f_m has learned, M is the softmax of -32 G."""
    network = BodyNetwork(BodyConfig(features=4, width=8))
    distances = torch.full((1, JOINT_COUNT), 50.0)
    distances[0, 3], distances[0, 5] = 0.02, 0.05
    attention = network.attention_map(distances)[0].detach()
    assert float(attention[3]) == pytest.approx(1 / (1 + math.exp(-32 * 0.03)), rel=1e-4)
    assert float(attention.sum()) == pytest.approx(1)


@pytest.mark.parametrize("geodesics", ["attention", "none", "sorted"])
def test_weights_add_up(geodesics, tmp_path):
    body = reference_body()
    mesh = sampled_mesh(body.vertices, body.faces, body.joints, 200)
    distances = torch.from_numpy(joint_distances(body.vertices, body.faces, body.joints, mesh.clean))
    torch.manual_seed(0)
    network = BodyNetwork(BodyConfig(features=4, width=16, geodesics=geodesics))
    graph = node_graph([mesh.neighbours], [mesh.part])
    points, normals = torch.from_numpy(mesh.points), torch.from_numpy(mesh.normals)
    with torch.no_grad():
        weights = network(points, normals, torch.from_numpy(mesh.joints)[None], distances, graph)
    assert weights.shape == (len(mesh.points), JOINT_COUNT)
    np.testing.assert_allclose(weights.sum(dim=1), 1, atol=1e-5)
    again = BodyNetwork.load(network.save(tmp_path / "body.safetensors"))
    assert torch.equal(again(points, normals, torch.from_numpy(mesh.joints)[None], distances, graph), weights)


def test_geodesic_distances_go_along_the_mesh():
    """On the reference body the hands are nearer to their own wrists than to the other's, and G is the straight way out
    of the joint and Dijkstra's on the edges from there.
    """
    body = reference_body()
    mesh = sampled_mesh(body.vertices, body.faces, body.joints, 300)
    distances = joint_distances(body.vertices, body.faces, body.joints, mesh.clean)
    assert np.isfinite(distances).all() and (distances >= 0).all()
    from bunraku.core.geometry.graph import clean_mesh, unique_edges

    clean = clean_mesh(body.vertices, body.faces)
    edges = unique_edges(clean.faces, len(clean.vertices))
    lengths = np.linalg.norm(clean.vertices[edges[:, 0]] - clean.vertices[edges[:, 1]], axis=1)
    from scipy.sparse import coo_matrix

    graph = coo_matrix((lengths, tuple(edges.T)), shape=(len(clean.vertices),) * 2)
    joint = (body.joints[20] - clean.center) / clean.scale
    gaps = np.linalg.norm(clean.vertices - joint, axis=1)
    height = np.ptp(clean.vertices[:, 1])
    nearest = int(gaps.argmin())
    plain = dijkstra(graph.tocsr(), directed=False, indices=nearest)[mesh.clean] + gaps[nearest]
    found = distances[:, 20] * height
    assert (found <= plain + 1e-5).all() and (found >= gaps[mesh.clean] - 1e-5).all()  # no longer, and not shorter
    starts = np.flatnonzero(gaps < 3 * gaps.min())
    ways = dijkstra(graph.tocsr(), directed=False, indices=starts)[:, mesh.clean] + gaps[starts, None]
    assert (found >= ways.min(axis=0) - 0.02 * height).all()
    hand = mesh.points[:, 0] > 0.9 * mesh.points[:, 0].max()
    assert (distances[hand, 20] < distances[hand, 21]).all()


def test_layers_that_lie_on_one_another_are_joined_everywhere():
    """A sleeve over an arm: from a joint in the arm it is as near as the arm is, not as far as where it is sewn on."""
    rings, sides = 41, 16
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    index = np.arange(rings * sides).reshape(rings, sides)
    beside = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], index[1:], beside[1:], beside[:-1]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    along = np.repeat(np.linspace(0, 1.0, rings), sides)
    ring = np.stack([np.cos(np.tile(angle, rings)), 0 * along, np.sin(np.tile(angle, rings))], axis=1)
    tubes = [radius * ring + along[:, None] * [0, 1, 0] for radius in (0.04, 0.05)]
    joints = np.linspace([0, 0.1, 0], [0, 0.9, 0], JOINT_COUNT)
    both = np.concatenate([faces, faces + len(ring)])
    mesh = sampled_mesh(np.concatenate(tubes), both, joints, 2 * len(ring))
    distances = joint_distances(np.concatenate(tubes), both, joints, mesh.clean)
    height = np.abs(mesh.points[:, 1:2] - mesh.joints[:, 1])
    assert np.abs(distances - height).max() < 0.08  # straight along the tube, whatever side or layer a point is on


def test_parts_of_apparel():
    """Two squares that share an edge but for a seam of the file, and one apart."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0],
                       [5, 0, 0], [6, 0, 0], [6, 1, 0], [9, 9, 9], [9, 8, 9], [8, 9, 9]])  # fmt: skip
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [11, 12, 13]])
    apparel = np.arange(14) < 11
    assert apparel_parts(points, faces, apparel).tolist() == [0] * 8 + [1] * 3 + [-1] * 3


def test_losses_by_hand():
    assert float(mask_loss(torch.zeros(2), torch.tensor([0.0, 1.0]))) == pytest.approx(math.log(2))
    points = torch.tensor([[0.0, 0, 0], [0, 2, 0]])
    truth = torch.tensor([[1.0, -1, 0.5], [0, 2, 0]])
    assert float(vertex_loss(points, truth)) == pytest.approx(1.25)  # (2.5 + 0) / 2
    rest = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
    edges = torch.tensor([[0, 1]])
    assert float(edge_loss(points, rest, edges)) == pytest.approx(1.0)  # 2 now, 1 at rest
    assert float(edge_loss(points[None], rest, edges[:0])) == 0
    weights = torch.tensor([[1.0, 0.0], [0.4, 0.8]])
    assert float(smoothness_loss(weights, edges)) == pytest.approx(1.0)  # (0.6, -0.8) has length 1


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
