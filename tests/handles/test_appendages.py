"""Ears of a head are told by shape alone and get handles of their own; what is no appendage stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.appendages import find_appendages, with_appendages

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
NECK = 0.9


def figure(ears: float = 0.5):
    """A box with a ball for a head, which has two cones of some length for ears."""
    pieces = [
        trimesh.creation.box((0.5, 0.9, 0.3)).apply_translation([0, 0.45, 0]),
        trimesh.creation.icosphere(3, 0.25).apply_translation([0, 1.1, 0]),
    ]
    if ears:
        for side in (-1, 1):
            cone = trimesh.creation.cone(0.06, ears).subdivide().subdivide()
            cone.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], [0.5 * side, 1, 0]))
            pieces.append(cone.apply_translation([0.11 * side, 1.31, 0]))
    whole = trimesh.util.concatenate([piece.subdivide() for piece in pieces])
    mesh = network_mesh(whole.vertices, whole.faces, 2500)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    high = position[:, 1] > NECK
    weights[high, H["head"]], weights[~high, H["spine2"]] = 1, 1
    return mesh, position, weights


def test_two_ears_are_found_from_root_to_tip():
    mesh, position, weights = figure()
    found = find_appendages(mesh, weights)
    assert len(found) == 2
    sides = sorted(np.sign(position[one.members][:, 0].mean()) for one in found)
    assert sides == [-1, 1]
    for one in found:
        assert one.length * mesh.scale == pytest.approx(0.5, abs=0.1)
        assert position[one.members][:, 1].max() > position[:, 1].max() - 0.05


@pytest.mark.parametrize("ears", [0.0, 0.06])
def test_a_round_head_has_none(ears):
    mesh, _, weights = figure(ears)
    assert find_appendages(mesh, weights) == []
    same, _, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    assert roles is None and same is weights


def test_each_gets_a_spare_handle_that_plays_the_top_of_the_head():
    mesh, position, weights = figure()
    out, full, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    own = np.flatnonzero(roles != np.arange(HANDLE_COUNT))
    assert len(own) == 2 and (roles[own] == H["head_top"]).all()
    np.testing.assert_allclose(out.sum(axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(full.sum(axis=1), 1, atol=1e-5)
    tips = position[:, 1] > position[:, 1].max() - 0.1
    np.testing.assert_allclose(out[tips][:, own].max(axis=1), 1, atol=1e-5)
    body = position[:, 1] < NECK
    np.testing.assert_allclose(out[body], weights[body], atol=1e-6)


def test_handles_that_are_in_use_are_not_taken():
    mesh, position, weights = figure()
    below = position[:, 1] < 0.3
    weights[below] = 0
    used = ["face", "left_fingers", "right_fingers", "left_foot", "right_foot", "tail_tip", "tail", "left_wing"]
    for number, name in enumerate(used):
        weights[np.flatnonzero(below)[number :: len(used)], H[name]] = 1
    _, _, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    assert np.flatnonzero(roles != np.arange(HANDLE_COUNT)).tolist() == [H["right_wing"]]
