"""Stray regions go back, steep steps far from a joint are softened, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.repairs import (
    MOST,
    TURN,
    eased,
    edge_strain,
    grown_from_heads,
    hung_from_heads,
    reunited,
    without_doubts,
)

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}


def box_body(tail: bool = False):
    """A trunk with two arms along x, an ear on top of it and, where asked for, a tail behind it; one closed skin each
    that touch.
    """
    pieces = [
        trimesh.creation.box((0.4, 1, 0.4)),
        trimesh.creation.box((0.8, 0.15, 0.15)).apply_translation([0.6, 0.2, 0]),
        trimesh.creation.box((0.8, 0.15, 0.15)).apply_translation([-0.6, 0.2, 0]),
        trimesh.creation.box((0.1, 0.3, 0.1)).apply_translation([0.1, 0.62, 0]),
    ]
    if tail:
        pieces.append(trimesh.creation.box((0.1, 0.1, 0.6)).apply_translation([0, -0.3, -0.5]))
        pieces += [trimesh.creation.box((0.15, 0.7, 0.15)).apply_translation([x, -0.8, 0]) for x in (-0.12, 0.12)]
    whole = trimesh.util.concatenate([piece.subdivide().subdivide().subdivide() for piece in pieces])
    return network_mesh(whole.vertices, whole.faces, 2500)


def hard(mesh, *rules):
    """The trunk's weights, and 1 for a handle where a rule says so."""
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    weights[:, H["spine2"]] = 1
    for name, rule in rules:
        where = rule(position)
        weights[where] = 0
        weights[where, H[name]] = 1
    return position, weights


def arms(position, side):
    return (side * position[:, 0] > 0.25) & (np.abs(position[:, 1] - 0.2) < 0.12)


def ear(position):
    return position[:, 1] > 0.55


def test_an_ear_that_was_called_a_hand_goes_back_to_the_trunk():
    mesh = box_body()
    position, weights = hard(
        mesh,
        ("left_wrist", lambda p: arms(p, 1)),
        ("right_wrist", lambda p: arms(p, -1)),
        ("left_wrist", ear),
    )
    out = reunited(mesh, weights)
    assert (out[ear(position)].argmax(axis=1) == H["spine2"]).all()
    kept = ~ear(position)
    np.testing.assert_allclose(out[kept], weights[kept], atol=1e-6)


def test_ears_are_no_arms():
    """An ear that was called an arm, as large as one, stands on the head; the arms, which meet the trunk, stay arms."""
    mesh = box_body()
    position, weights = hard(
        mesh,
        ("head", lambda p: (p[:, 1] > 0.38) & ~ear(p)),
        ("left_wrist", lambda p: arms(p, 1) | ear(p)),
        ("right_wrist", lambda p: arms(p, -1)),
    )
    held = grown_from_heads(mesh, weights)
    top = ear(position)
    assert held[top, H["head_top"]].min() > 0.99 and held[top, H["left_wrist"]].max() < 0.01
    np.testing.assert_array_equal(held[arms(position, 1)], weights[arms(position, 1)])
    np.testing.assert_array_equal(held[arms(position, -1)], weights[arms(position, -1)])


def test_who_is_all_head_has_its_arms_there():
    mesh = box_body()
    _, weights = hard(
        mesh,
        ("head", lambda p: np.abs(p[:, 0]) < 2),
        ("left_wrist", lambda p: arms(p, 1)),
        ("right_wrist", lambda p: arms(p, -1)),
    )
    np.testing.assert_array_equal(grown_from_heads(mesh, weights), weights)


def test_a_tail_that_played_a_leg_becomes_a_tail():
    mesh = box_body(tail=True)
    position, weights = hard(
        mesh,
        ("pelvis", lambda p: (np.abs(p[:, 0]) < 0.21) & (p[:, 1] < 0)),
        ("right_hip", lambda p: (p[:, 1] < -0.52) & (p[:, 0] < 0)),
        ("left_hip", lambda p: (p[:, 1] < -0.52) & (p[:, 0] > 0)),
        ("right_hip", lambda p: p[:, 2] < -0.25),
    )
    out = reunited(mesh, weights)
    behind = position[:, 2] < -0.25
    assert (out[behind].argmax(axis=1) == H["tail"]).all()
    legs = position[:, 1] < -0.52
    np.testing.assert_allclose(out[legs], weights[legs], atol=1e-6)


def test_regions_that_touch_across_loose_parts_are_one():
    """A sleeve over an arm is no stray piece, though no edge joins them."""
    mesh = box_body()
    _, weights = hard(mesh, ("left_shoulder", lambda p: (p[:, 0] > 0.1) & (np.abs(p[:, 1] - 0.2) < 0.12)))
    np.testing.assert_allclose(reunited(mesh, weights), weights, atol=1e-6)


def test_the_reference_body_stays_as_it_is():
    body = reference_body()
    mesh = network_mesh(body.vertices, body.faces, 2500)
    weights = mesh.pull(body.handle_weights)
    weights /= weights.sum(axis=1, keepdims=True)
    assert np.abs(reunited(mesh, weights) - weights).sum(axis=1).mean() < 2e-3
    assert np.abs(eased(mesh, weights) - weights).sum(axis=1).mean() < 2e-3


def test_strain_is_what_a_turn_does_to_an_edge():
    """Against edges that are really turned, about the joint between trunk and arm."""
    mesh = box_body()
    position, weights = hard(mesh)
    share = np.clip((mesh.vertices[:, 0] - 0.15) / 0.1, 0, 1) * arms(position, 1)
    weights[:, H["left_elbow"]], weights[:, H["spine2"]] = share, 1 - share
    overlap = mesh.areas * share * (1 - share)
    joint = overlap @ mesh.vertices / overlap.sum()
    points = mesh.vertices - joint
    turned = points + share[:, None] * (points @ matrix_from_axis_angle(np.array([0, 0, TURN])).T - points)
    first, second = mesh.edges.T
    before, after = (np.linalg.norm(p[first] - p[second], axis=1) for p in (points, turned))
    growth = (after - before) / np.maximum(before, 0.25 * mesh.cell)
    assert (growth <= edge_strain(mesh, weights) + 1e-3).all()  # a bound, whichever way the limb turns
    assert edge_strain(mesh, weights).max() < 3 * growth.max() + 0.5


def test_a_step_far_from_the_joint_is_softened():
    """An arm whose skin is one with the side of the body: its share falls from 1 to 0 over an edge."""
    trunk = trimesh.creation.box((1, 2, 0.3)).subdivide().subdivide().subdivide().subdivide()
    mesh = network_mesh(trunk.vertices, trunk.faces, 2500)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    weights[:, H["left_shoulder"]] = position[:, 0] > 0.2  # an arm glued to the side of the body over its whole length
    weights[:, H["spine2"]] = 1 - weights[:, H["left_shoulder"]]
    before, after = edge_strain(mesh, weights), edge_strain(mesh, eased(mesh, weights))
    assert before.max() > 2 * MOST and after.max() < 0.6 * before.max()
    np.testing.assert_allclose(eased(mesh, weights).sum(axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("repair", [reunited, eased])
def test_repairs_leave_one_handle_alone(repair):
    mesh = box_body()
    _, weights = hard(mesh)
    np.testing.assert_allclose(repair(mesh, weights), weights, atol=1e-6)


@pytest.mark.parametrize(("left", "right", "there"), [(0.3, 0.4, False), (0.3, 0.9, True), (0.9, 0.9, True)])
def test_a_limb_that_holds_no_vertex_surely_is_not_there(left, right, there):
    weights = np.zeros((6, HANDLE_COUNT), np.float32)
    weights[:, H["head"]] = 1
    for row, side, share in ((0, "left", left), (1, "right", right)):
        weights[row, [H[f"{side}_wrist"], H[f"{side}_elbow"], H["head"]]] = [0.5 * share, 0.5 * share, 1 - share]
    found = without_doubts(weights)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)
    if there:
        np.testing.assert_allclose(found, weights, atol=1e-6)
    else:
        np.testing.assert_allclose(found[:, H["head"]], 1)


def test_hair_that_lies_on_an_arm_goes_with_the_head():
    """A loose tail from the crown down to the hand, which the network gives half to the arm; a sleeve stays with it."""
    trunk = trimesh.creation.box((1, 2, 0.5))
    head = trimesh.creation.box((0.8, 0.8, 0.8)).apply_translation([0, 1.5, 0])
    arm = trimesh.creation.box((0.3, 1.6, 0.3)).apply_translation([0.8, 0.1, 0])
    tail = trimesh.creation.box((0.1, 2.6, 0.1)).apply_translation([1.1, 0.6, 0])
    pieces = [piece.subdivide().subdivide().subdivide() for piece in (trunk, head, arm, tail)]
    whole = trimesh.util.concatenate(pieces)
    mesh = network_mesh(whole.vertices, whole.faces, 2500)
    position = mesh.vertices * mesh.scale + mesh.center
    owner = np.array([H["spine2"], H["head"], H["left_shoulder"]])
    hair = position[:, 0] > 1.0
    nearest = np.where(np.abs(position[:, 0]) > 0.6, 2, np.where(position[:, 1] > 1.05, 1, 0))
    hard_weights = np.eye(HANDLE_COUNT, dtype=np.float32)[owner[nearest]]
    hard_weights[hair] = 0
    hard_weights[hair, H["left_wrist"]] = position[hair, 1] <= 0.9
    hard_weights[hair, H["head"]] = position[hair, 1] > 0.9
    found = hung_from_heads(mesh, hard_weights)
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found[~hair], hard_weights[~hair])
    assert found[hair][:, [H["head"], H["head_top"]]].sum(axis=1).min() > 0.999
