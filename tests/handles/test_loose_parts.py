"""Loose parts: a button takes one row of the surface below it, a sleeve and a hand keep what was said of them."""

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.loose_parts import find_loose_parts, seat_parts

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
BUTTON, HAND = np.array([0, 0.5, 0.52]), np.array([1.06, -0.5, 0])


@pytest.fixture(scope="module")
def dressed():
    """A body with a button on it, a sleeve that sticks out of it, and a hand that touches it with one side."""
    body = trimesh.creation.box((1, 2, 1)).subdivide().subdivide()
    button = trimesh.creation.icosphere(2, 0.03).apply_translation(BUTTON)
    sleeve = trimesh.creation.box((0.8, 0.1, 0.1)).subdivide().apply_translation([0.92, 0.5, 0])
    hand = trimesh.creation.box((0.1, 0.2, 0.1)).subdivide().apply_translation(HAND - [0.5, 0, 0])
    whole = trimesh.util.concatenate([body, button, sleeve, hand])
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    return mesh, mesh.vertices * mesh.scale + mesh.center, mesh.clean.vertices * mesh.scale + mesh.center


def weights_of(position):
    """The body turns from handle 0 to handle 1 along its height; the button is said to be split, the hand all of handle
    3.
    """
    up = np.clip(0.5 + position[:, 1], 0, 1)
    weights = np.stack([1 - up, up, 0 * up, 0 * up], axis=1)
    on_button = np.linalg.norm(position - BUTTON, axis=1) < 0.04
    weights[on_button] = np.where(position[on_button, 1:2] > 0.5, [0, 0, 0.4, 0.6], [0, 0, 1, 0])
    weights[position[:, 0] > 0.505] = [0, 0, 1, 0]
    weights[position[:, 0] > 0.9] = [0, 0, 0, 1]
    hand = (position[:, 0] > 0.505) & (position[:, 1] < 0)
    weights[hand] = [0, 0, 0.1, 0.9]
    return weights.astype(np.float32)


def test_how_parts_lie_on_others(dressed):
    mesh, _, _ = dressed
    parts = find_loose_parts(mesh)
    order = np.argsort(parts.extent)
    assert len(order) == 4
    np.testing.assert_allclose(parts.extent[order], [0.03, 0.1, 0.4, 1], atol=0.005)
    assert parts.cover[order[0]] > 0.95 and 0.05 < parts.cover[order[1]] < 0.6 and (parts.cover[order[2:]] == 0).all()


def test_a_button_moves_with_what_it_sits_on(dressed):
    mesh, position, clean = dressed
    weights = weights_of(position)
    full = seat_parts(mesh, weights)
    button = np.abs(np.linalg.norm(clean - BUTTON, axis=1) - 0.03) < 0.002
    assert button.sum() > 100 and (full[button] == full[button][0]).all()
    np.testing.assert_allclose(full[button][0], [0, 1, 0, 0], atol=0.02)


def test_a_hand_keeps_its_own_and_a_sleeve_bends(dressed):
    mesh, position, clean = dressed
    weights = weights_of(position)
    full = seat_parts(mesh, weights)
    hand = (clean[:, 0] > 0.52) & (clean[:, 1] < 0)
    assert (full[hand] == full[hand][0]).all() and full[hand][0].argmax() == 3 and full[hand][0, 3] > 0.95
    sleeve = (clean[:, 0] > 0.505) & (clean[:, 1] > 0.4)
    assert full[sleeve, 2].max() > 0.9 and full[sleeve, 3].max() > 0.9
    body = (np.abs(clean[:, 0]) <= 0.35) & (np.linalg.norm(clean - BUTTON, axis=1) > 0.1)
    np.testing.assert_array_equal(full[body], mesh.push_clean(weights)[body])
    np.testing.assert_allclose(full.sum(axis=1), 1, atol=1e-5)


def test_one_part_alone_stays_as_it_is():
    ball = trimesh.creation.icosphere(3)
    mesh = network_mesh(ball.vertices, ball.faces, 600)
    weights = np.stack([mesh.vertices[:, 1] + 0.5, 0.5 - mesh.vertices[:, 1]], axis=1)
    full = seat_parts(mesh, weights)
    np.testing.assert_allclose(full, mesh.push_clean(weights))


def arrows():
    """A body, a quiver on its back, an arrow that sticks out of the quiver and a feather on the arrow's end."""
    body = trimesh.creation.box((1, 3, 1)).subdivide().subdivide()
    quiver = trimesh.creation.box((0.2, 0.7, 0.2)).subdivide().apply_translation([0, 0.5, -0.6])
    arrow = trimesh.creation.box((0.04, 0.5, 0.04)).subdivide().apply_translation([0.003, 1.107, -0.597])
    feather = trimesh.creation.box((0.1, 0.1, 0.02)).subdivide().apply_translation([0, 1.412, -0.6])
    return trimesh.util.concatenate([body, quiver, arrow, feather])


def test_a_chain_of_pieces_follows_what_it_sticks_in():
    whole = arrows()
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    behind = position[:, 2] < -0.48
    weights[:, H["spine3"]] = 1
    weights[behind & (position[:, 1] > 0.88)] = np.eye(HANDLE_COUNT)[H["left_wrist"]]  # the arrow flies with a hand
    weights[behind & (position[:, 1] > 1.34)] = np.eye(HANDLE_COUNT)[H["right_knee"]]  # and its feather with a leg
    full = seat_parts(mesh, weights)
    clean = mesh.clean.vertices * mesh.scale + mesh.center
    for piece in (clean[:, 1] > 1.34, (clean[:, 2] < -0.55) & (clean[:, 1] > 0.9) & (np.abs(clean[:, 0]) < 0.03)):
        piece = piece & (clean[:, 2] < -0.55)
        assert piece.any() and (full[piece].argmax(axis=1) == H["spine3"]).all()


def test_an_arm_of_many_small_pieces_keeps_its_hand():
    """Each touches the one before it, and the hand no larger part."""
    body = trimesh.creation.box((1, 2, 1)).subdivide().subdivide()
    balls = [trimesh.creation.icosphere(2, 0.05).apply_translation([0.55 + 0.1 * k, 0.6, 0]) for k in range(8)]
    whole = trimesh.util.concatenate([body, *balls])
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    position, clean = mesh.vertices * mesh.scale + mesh.center, mesh.clean.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    weights[:, H["spine3"]] = 1
    for part, start in (("left_shoulder", 0.505), ("left_elbow", 0.8), ("left_wrist", 1.1)):
        weights[position[:, 0] > start] = np.eye(HANDLE_COUNT)[H[part]]
    full = seat_parts(mesh, weights)
    assert (full[clean[:, 0] > 1.21].argmax(axis=1) == H["left_wrist"]).all()


def test_hair_that_the_head_s_handles_share_is_one_with_the_head():
    body = trimesh.creation.box((1, 3, 1)).subdivide().subdivide()
    hair = trimesh.creation.box((0.8, 0.5, 0.5)).subdivide().subdivide().apply_translation([0, 2.0, 0])
    whole = trimesh.util.concatenate([body, hair])
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    weights[:, H["spine3"]] = 1
    on = position[:, 1] > 1.6
    weights[on] = 0.5 * np.eye(HANDLE_COUNT)[H["head"]] + 0.4 * np.eye(HANDLE_COUNT)[H["head_top"]]
    weights[on, H["neck"]] = 0.1
    full = seat_parts(mesh, weights)
    clean = mesh.clean.vertices * mesh.scale + mesh.center
    assert (full[clean[:, 1] > 1.7, H["head"]] > 0.9999).all()


def test_a_fleck_that_touches_nothing_stays_with_what_is_nearest():
    """Whatever the network takes it for; a hand as far away keeps its own."""
    body = trimesh.creation.box((1, 2, 1)).subdivide().subdivide()
    fleck = trimesh.creation.icosphere(2, 0.03).apply_translation([0, 0.9, 0.65])
    hand = trimesh.creation.box((0.25, 0.3, 0.25)).subdivide().apply_translation([0.8, -0.5, 0])
    whole = trimesh.util.concatenate([body, fleck, hand])
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    position, clean = mesh.vertices * mesh.scale + mesh.center, mesh.clean.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    weights[:, H["spine3"]] = 1
    for part, where in (("left_ankle", position[:, 2] > 0.55), ("left_wrist", position[:, 0] > 0.55)):
        weights[where] = np.eye(HANDLE_COUNT)[H[part]]
    full = seat_parts(mesh, weights)
    assert (full[clean[:, 2] > 0.55].argmax(axis=1) == H["spine3"]).all()
    assert (full[clean[:, 0] > 0.55].argmax(axis=1) == H["left_wrist"]).all()
