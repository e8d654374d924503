"""The displacement network's parts: each layer and formula against a value that is computed by hand."""

import math
from dataclasses import replace

import igl
import numpy as np
import pytest
import torch

from bunraku.apparel.body import BodyPoints, body_points, eq4_transforms, surface_points
from bunraku.apparel.clothed import ClothedCharacter, Swing
from bunraku.apparel.learned.features import (
    BASIS,
    DAMPING,
    FREQUENCIES,
    GLOBAL,
    OWN,
    PENDULUMS,
    MotionFilters,
    Pendulums,
    lead_in_transforms,
    rest_transforms,
    static_features,
)
from bunraku.apparel.learned.network import DisplacementConfig, FoldedNetwork
from bunraku.apparel.learned.network import past_of_states as folded_past
from bunraku.apparel.learned.player import ApparelPlayer, Carrier, Safety, SafetySettings, node_turns
from bunraku.apparel.nodes import NodeGraph, apparel_nodes
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import line_up
from bunraku.errors import WeightsError
from bunraku_lab.evaluation.apparel.clips import KnownPlayer
from bunraku_lab.nn.apparel import (
    DisplacementNetwork,
    Inputs,
    clip_features,
    mirror_global,
    past_of_states,
    running_displacement,
)
from bunraku_lab.nn.graph import EdgeBlock, node_graph


def curtain(rows=7, columns=4):
    """A body and a curtain of cloth that hangs from its pelvis, a few centimetres before it."""
    body = reference_body()
    across, down = np.meshgrid(np.linspace(-0.1, 0.1, columns), np.linspace(0, 0.5, rows))
    pelvis = body.joints[0]
    cloth = np.stack([across, pelvis[1] - down, np.full_like(across, pelvis[2] + 0.25)], axis=-1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]) + len(body.vertices)
    own = np.zeros((len(cloth), JOINT_COUNT), np.float32)
    own[:, 0] = 1
    apparel = np.arange(len(body.vertices) + len(cloth)) >= len(body.vertices)
    return ClothedCharacter(
        np.concatenate([body.vertices, cloth]).astype(np.float32), np.concatenate([body.faces, faces]),
        np.asarray(body.joints), np.concatenate([body.joint_weights, own]).astype(np.float32), apparel,
        np.where(apparel, 0, -1), np.array([-1.0], np.float32), np.array([0.9], np.float32),
    )  # fmt: skip


def still(clothed, frames):
    """The rest pose, for so many frames, shape (F, 22, 3, 4)."""
    pose = np.concatenate([np.tile(np.eye(3), (JOINT_COUNT, 1, 1)), clothed.joints[..., None]], axis=2)
    return np.tile(pose, (frames, 1, 1, 1)).astype(np.float32)


def inputs_of(clothed, nodes, frame):
    vectors, scalars = static_features(clothed, nodes)
    graph = node_graph([nodes.neighbours], [nodes.part])
    moving = (torch.from_numpy(value) for value in (frame.vectors, frame.scalars))
    return Inputs(
        torch.from_numpy(vectors), torch.from_numpy(scalars), *moving, torch.from_numpy(frame.whole)[None], graph
    )


def test_an_oscillator_by_hand():
    """One step of `y'' + 2 z w y' + w^2 y = -p''` after a jump of what carries it, then the next."""
    filters = MotionFilters(np.zeros((1, 3)), np.eye(3)[None], fps=10.0)
    velocity, acceleration = filters.advance(np.array([[0.2, 0, 0]]), np.eye(3)[None])
    assert velocity[0, 0] == pytest.approx(2.0) and acceleration[0, 0] == pytest.approx(20.0)
    speed, sway = -2.0, -0.2
    assert filters.sway[:, 0, 0] == pytest.approx(sway)
    filters.advance(np.array([[0.2, 0, 0]]), np.eye(3)[None])  # it stands again: p'' = -20
    w = 2 * math.pi * FREQUENCIES[0]
    speed = speed + 0.1 * (20.0 - 2 * DAMPING * w * speed - w * w * sway)
    assert filters.sway[0, 0, 0] == pytest.approx(sway + 0.1 * speed, rel=1e-4)


def test_filters_forget():
    """Whatever went before, a minute of standing still leaves nothing: what is computed from them cannot drift."""
    random = np.random.default_rng(0)
    filters = MotionFilters(np.zeros((1, 3)), np.eye(3)[None])
    for _ in range(60):
        turn = matrix_from_axis_angle(random.normal(size=(1, 3)))
        filters.advance(random.normal(size=(1, 3)), turn)
    assert np.abs(filters.sway).max() > 0.1
    for _ in range(1800):
        filters.advance(np.ones((1, 3)), np.eye(3)[None])
    assert np.abs(filters.sway).max() < 1e-6 and np.abs(filters.late - np.eye(3)).max() < 1e-5


def test_pendulums_keep_their_lengths_and_come_to_hang_as_forces_balance():
    held = np.array([[0.3, 0, 0], [0, -0.4, 0]], np.float32)
    positions, turns = held + [0, 1, 0], np.repeat(np.eye(3)[None], 2, axis=0)
    hung = Pendulums(positions, held, turns, 1.0)
    for _ in range(600):
        away = hung.advance(positions, turns) + held
        np.testing.assert_allclose(np.linalg.norm(away, axis=2), [[0.3, 0.4]] * len(PENDULUMS), rtol=1e-4)
    for (spring, _), sideways, down in zip(PENDULUMS, away[:, 0], away[:, 1], strict=True):
        # gravity and the spring's pull to (0.3, 0, 0) leave nothing across the rod
        pull = np.array([0, -9.80665, 0]) - spring * (sideways - [0.3, 0, 0])
        across = np.array([-sideways[1], sideways[0], 0]) / 0.3
        assert abs(pull @ across) < 0.01 * 9.80665 and sideways[1] < 0
        np.testing.assert_allclose(down, [0, -0.4, 0], atol=1e-5)


def swinging(clothed, limit):
    """The curtain, each vertex of which swings about its upper edge as far as a limit, as a file would say."""
    away = (clothed.rest - clothed.joints[0]) * np.array([0, 1, 0])
    count = len(away)
    wide, one = np.full((count, 3), limit), np.ones(count)
    told = Swing(away, away, np.tile([0, -0.3, 0], (count, 1)), np.tile(np.eye(3), (count, 1, 1)), -wide,
                 wide, np.zeros((count, 3)), 0.5 * one, 0.1 * one, one, one)  # fmt: skip
    return replace(clothed, swing=told.rows())


def test_a_told_limit_is_felt_by_the_pendulums_of_a_node():
    """The curtain is carried to and fro: the basis has how far each node would swing, and what holds it is told."""
    times = np.arange(60) / 30
    clothed = curtain()
    transforms = np.array(still(clothed, len(times)))
    transforms[:, :, 2, 3] += 0.3 * (1 - np.cos(4 * times))[:, None]
    swings = {}
    for limit in (0.01, 0.1, np.pi):
        told = swinging(clothed, limit)
        nodes = apparel_nodes(told, 12)
        frames = clip_features(told, nodes, transforms)
        swings[limit] = np.stack([frame.vectors[:, BASIS - len(OWN)] for frame in frames])
        low = nodes.rest[:, 1].argmin()
        assert frames[-1].scalars[:, 2].max() <= limit * np.sqrt(3) + 1e-6
        numbers = static_features(told, nodes)[1][:, -7:]
        assert numbers[:, -1].tolist() == [1] * len(nodes)
        assert 10 ** numbers[low, 0] == pytest.approx(limit * np.sqrt(2) if limit < 1 else np.pi, rel=0.2)
    assert np.abs(swings[np.pi][:, low]).max() > 2 * np.abs(swings[0.1][:, low]).max() > 4 * np.abs(swings[0.01]).max()
    bare = static_features(clothed, nodes)[1][:, -1]
    assert bare.tolist() == [0] * len(nodes)  # nothing is told


def test_a_mirrored_pose_has_mirrored_features():
    random = np.random.default_rng(1)
    whole = random.normal(size=GLOBAL).astype(np.float32)
    np.testing.assert_allclose(mirror_global(mirror_global(whole)), whole)
    turn = matrix_from_axis_angle(np.array([0.3, -0.5, 0.7]))
    flip = np.diag([-1.0, 1, 1])
    both = turn, flip @ turn @ flip
    rows = [np.zeros((JOINT_COUNT, 9)) for _ in both]
    for row, own in zip(rows, both, strict=True):
        row[0, 3:] = own[:, :2].T.reshape(-1)  # of the pelvis, which is its own mirror image
    ours = mirror_global(np.append(rows[0].reshape(-1), [0, 1, 0]))
    np.testing.assert_allclose(ours[:9], rows[1][0], atol=1e-12)


def test_the_lead_in_goes_from_rest_to_the_first_frame():
    clothed = curtain()
    first = still(clothed, 1)[0].copy()
    first[:, :, :3] = matrix_from_axis_angle(np.array([0.0, 1.0, 0.0])) @ first[:, :, :3]
    first[:, :, 3] = first[:, :, 3] @ matrix_from_axis_angle(np.array([0.0, 1.0, 0.0])).T + [1, 0, 2]
    way = lead_in_transforms(clothed.joints, first, 20)
    np.testing.assert_allclose(way[0], rest_transforms(clothed.joints, first), atol=1e-5)
    np.testing.assert_allclose(way[-1], first, atol=1e-5)


def test_parts_do_not_hear_of_one_another():
    graph = node_graph([np.array([[1], [0]]), np.array([[0]])], [np.array([0, 0]), np.array([0])])
    assert graph.part.tolist() == [0, 0, 1] and graph.owner.tolist() == [0, 0, 1] and graph.edges.tolist() == [[0, 1]]
    x = torch.tensor([[1.0], [4.0], [9.0]])
    torch.manual_seed(0)
    block = EdgeBlock(1)
    before = block(x, graph)
    after = block(torch.tensor([[1.0], [4.0], [-3.0]]), graph)
    assert torch.equal(before[:2], after[:2])


def displacements(carrier, moved):
    """Of the apparel vertices in the frames of their joints [m], shape (A, 3)."""
    return carrier.mix @ carrier._swung(moved)[carrier.node].reshape(-1, 3)


def test_vertices_by_the_plain_formula():
    """Sum of shares of `m_i + T_i a - a` over the nodes around, in the frame of the vertex' joint, on what its skin
    says.
    """
    clothed = curtain(14, 8)
    chest = JOINT_NAMES.index("spine3")
    weights = np.array(clothed.weights)
    weights[np.flatnonzero(clothed.apparel)[::3], [[0], [chest]]] = [[0.3], [0.7]]  # a third goes with another joint
    clothed = replace(clothed, weights=weights)
    nodes = apparel_nodes(clothed, 30)
    carrier, random = Carrier(clothed, nodes), np.random.default_rng(0)
    moved = random.normal(0, 0.05, (len(nodes), 3)).astype(np.float32)
    affine = np.concatenate([
        matrix_from_axis_angle(random.normal(0, 0.5, (JOINT_COUNT, 3))), random.normal(0, 0.3, (JOINT_COUNT, 3, 1))
    ], axis=2).astype(np.float32)  # fmt: skip
    turns = node_turns(nodes, carrier.spokes, carrier.prior, moved)
    positions, swung = carrier.positions(moved, affine), displacements(carrier, moved)
    for row in range(0, len(carrier.vertices), 7):
        vertex = carrier.vertices[row]
        rest, own = clothed.rest[vertex].astype(np.float64), clothed.weights[vertex]
        wanted = np.zeros(3)
        for node, share in zip(carrier.index[row], carrier.share[row], strict=True):
            away = rest - nodes.rest[node]
            wanted += share * (moved[node] + turns[node] @ away - away)
        np.testing.assert_allclose(swung[row], wanted, atol=1e-5)
        blend = np.einsum("j,jab->ab", own, affine)
        skinned = blend[:, :3] @ rest + blend[:, 3]
        np.testing.assert_allclose(positions[row], skinned + affine[own.argmax(), :, :3] @ wanted, atol=1e-5)


def test_safety_by_hand():
    clothed = curtain()
    nodes = apparel_nodes(clothed, 12)
    empty = np.zeros((0, 3), np.float32)
    nothing = BodyPoints(empty, empty, np.zeros((0, JOINT_COUNT), np.float32), np.zeros(0, np.int64))
    carrier = Carrier(clothed, nodes)
    safety = Safety(clothed, nodes, nothing, carrier, SafetySettings(passes=200))
    affine = np.tile(np.eye(4)[:3], (JOINT_COUNT, 1, 1)).astype(np.float32)
    random = np.random.default_rng(0)
    far = nodes.rest + random.normal(0, 0.05, nodes.rest.shape)
    a, b = safety.edges.T
    free = (safety.free[a, 0] + safety.free[b, 0]) > 0

    def worst(positions):
        ratio = np.linalg.norm(positions[a] - positions[b], axis=1) / safety.lengths
        return max((ratio[free] - 1.15).max(), (0.85 - ratio[free]).max())

    done = safety(far, affine)[0]
    assert worst(far) > 0.2 and worst(done) < 0.35 * worst(far)
    np.testing.assert_array_equal(safety(nodes.rest, affine)[0], nodes.rest)
    assert safety(nodes.rest, affine)[1] is None  # there is no body to be out of


def test_safety_pushes_out_of_the_body():
    """A curtain that is blown against the thighs comes to lie on them, all of its neighbourhood with it."""
    clothed = curtain(13, 9)
    nodes = apparel_nodes(clothed, 64)
    carrier = Carrier(clothed, nodes)
    safety = Safety(clothed, nodes, surface_points(clothed, 1500), carrier, SafetySettings(shortest=0.0, longest=9.0))
    affine = np.tile(np.eye(4)[:3], (JOINT_COUNT, 1, 1)).astype(np.float32)
    skin = clothed.rest.astype(float), clothed.faces[~clothed.apparel[clothed.faces].any(axis=1)]

    def deepest(points):
        inside = np.abs(igl.fast_winding_number(*skin, points.astype(float))) > 0.5
        away = np.sqrt(igl.point_mesh_squared_distance(points.astype(float), *skin)[0])
        return float((away * inside).max())

    rest, body = safety(nodes.rest, affine)
    np.testing.assert_allclose(rest, nodes.rest, atol=1e-6)
    blown = nodes.rest - np.array([0, 0, 0.22], np.float32) * (nodes.distance / nodes.length)[:, None]
    loose = safety.free[:, 0] > 0
    assert deepest(blown[loose]) > 0.012 and deepest(safety(blown, affine)[0][loose]) < 0.008
    vertices = clothed.rest[carrier.vertices] - np.array([0, 0, 0.16], np.float32)
    assert deepest(vertices) > 0.05 and deepest(safety.vertices(vertices, body)) < 0.015


def test_safety_lays_a_skirt_over_a_lifted_leg():
    """A thigh lifted through the curtain has it behind it, in nothing; the stage brings it in front again."""
    clothed = curtain(13, 9)
    nodes = apparel_nodes(clothed, 64)
    points = body_points(clothed, 1500)
    safety = Safety(clothed, nodes, points, Carrier(clothed, nodes))
    pose = still(clothed, 1)[0]
    hip, turn = JOINT_NAMES.index("left_hip"), matrix_from_axis_angle(np.array([-0.8, 0, 0]))
    for joint in range(JOINT_COUNT):
        if hip in line_up(joint, JOINT_PARENTS):
            pose[joint, :, :3] = turn
            pose[joint, :, 3] = clothed.joints[hip] + turn @ (clothed.joints[joint] - clothed.joints[hip])
    affine = eq4_transforms(pose[None], clothed.joints)[0]
    body = points.posed(affine)[0]

    def behind(positions):
        """Nodes with a point of the body before them, 2 cm to the side at most."""
        beside = np.linalg.norm(body[None, :, :2] - positions[:, None, :2], axis=-1) < 0.02
        return int((beside & (body[None, :, 2] > positions[:, None, 2] + 0.02)).any(axis=1).sum())

    assert behind(nodes.rest) > 3
    assert behind(safety(nodes.rest, affine)[0]) < 0.4 * behind(nodes.rest)


def test_a_player_gives_every_frame_alike():
    """Frame by frame or as a clip, and the same again after a minute elsewhere: the head has no memory."""
    torch.manual_seed(0)
    clothed = curtain()
    network = DisplacementNetwork(DisplacementConfig(16, 1, recurrent=0)).eval()
    for value in network.anchor.decoder[-1].parameters():
        torch.nn.init.normal_(value, 0, 0.05)
    poses = still(clothed, 8)
    poses[:, :, :3, :3] = matrix_from_axis_angle(np.linspace(0, 1, 8)[:, None] * [0.0, 1, 0])[:, None]
    player = ApparelPlayer(clothed, running_displacement(network), nodes=16)
    clip = player.clip(poses)
    again = ApparelPlayer(clothed, running_displacement(network), nodes=16)
    again.start(poses[0])
    np.testing.assert_array_equal(np.stack([again.advance(pose) for pose in poses]), clip)
    assert clip.shape == (8, int(clothed.apparel.sum()), 3) and np.isfinite(clip).all()


@pytest.mark.parametrize("frame", ["joint", "world"])
def test_the_folded_network_says_what_the_layers_say(frame):
    """Frame after frame, each network with its own past: the matrices of the player against the modules of training."""
    torch.manual_seed(0)
    clothed = curtain(13, 9)
    half = (clothed.part == 0) & (clothed.rest[:, 0] > 0.01)  # two parts
    two = np.array([-1.0, 0.0], np.float32)
    clothed = replace(
        clothed, part=np.where(half, 1, clothed.part), stiffness=two, damping=np.full(2, 0.9, np.float32), limit=None
    )
    nodes = apparel_nodes(clothed, 40)
    network = DisplacementNetwork(DisplacementConfig(16, 2, 8, frame)).eval()
    for part in (network.anchor, network.recurrent):
        torch.nn.init.normal_(part.encoder.mean, 0, 0.1)
        torch.nn.init.uniform_(part.encoder.std, 0.2, 1.0)
        torch.nn.init.normal_(part.decoder[-1].weight, 0, 0.05)
    poses = still(clothed, 6)
    poses[:, :, :3, :3] = matrix_from_axis_angle(np.linspace(0, 1, 6)[:, None] * [0.3, 1, 0])[:, None]
    graph = NodeGraph(nodes.neighbours, nodes.part)
    folded = FoldedNetwork(running_displacement(network), *static_features(clothed, nodes), graph)
    start = torch.zeros(3, len(nodes), 3)
    past = past_of_states(network.recurrent, start, start, torch.eye(3).expand(3, len(nodes), 3, 3), start + 0.1)
    zeros, eyes = np.zeros((3, len(nodes), 3), np.float32), np.tile(np.eye(3, dtype=np.float32), (3, len(nodes), 1, 1))
    arrays = folded_past(running_displacement(network).recurrent, zeros, zeros, eyes, zeros + np.float32(0.1))
    for one in clip_features(clothed, nodes, poses):
        inputs = inputs_of(clothed, nodes, one)
        turns, positions = torch.from_numpy(one.turns), torch.from_numpy(one.positions)
        with torch.no_grad():
            anchor = network.anchor(inputs)
            moved, past = network.recurrent(inputs, past, anchor, turns, positions)
        told = np.ascontiguousarray(one.vectors), one.scalars, one.whole
        head = folded.anchor(*told)
        fast, arrays = folded.recurrent(*told, arrays, head, one.turns, one.positions)
        np.testing.assert_allclose(head, anchor.numpy(), atol=2e-6)
        np.testing.assert_allclose(fast, moved.numpy(), atol=5e-6)
        for array, tensor in zip(arrays, (past.rest, past.whole, past.positions), strict=True):
            np.testing.assert_allclose(array, tensor.numpy(), atol=5e-6)
    assert np.abs(fast).max() > 1e-3


def test_a_known_difference_fades():
    """Three true frames, then the head with nine tenths of what it missed, then with nine tenths of that."""
    torch.manual_seed(0)
    clothed = curtain()
    network = DisplacementNetwork(DisplacementConfig(16, 1, recurrent=0)).eval()
    poses = still(clothed, 8)
    plain, told = (KnownPlayer(clothed, running_displacement(network), nodes=16, safe=False) for _ in range(2))
    rest = plain.clip(poses)
    told.start(poses[0])
    states = np.zeros((3, len(told.nodes), 3), np.float32)
    states[..., 2] = 0.1  # over the size
    told.know(states, poses[:3])
    first, second = told.advance(poses[3]) - rest[3], told.advance(poses[4]) - rest[4]
    np.testing.assert_allclose(first[:, 2], 0.9 * 0.1 * clothed.scale, rtol=0.05)
    np.testing.assert_allclose(second, 0.9 * first, atol=1e-4)


def test_a_network_comes_back_from_its_checkpoint(tmp_path):
    network = DisplacementNetwork(DisplacementConfig(16, 1, 8, "world"))
    path = network.save(tmp_path / "a.safetensors")
    again = DisplacementNetwork.load(path)
    assert again.config == network.config
    for one, other in zip(network.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)
    with pytest.raises(WeightsError):
        DisplacementNetwork.load(tmp_path / "none.safetensors")
