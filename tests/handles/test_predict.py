"""From the network's weights to those of a character: smoothing, loose parts, trimming, and the shipped predictor as a whole."""

import numpy as np
import pytest
import trimesh

from bunraku.bodies.layout import HANDLE_NAMES
from bunraku.character import Character
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.predict import predict_handles, smooth_weights, stiffen_parts, trim_weights
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku.samples import sample_character

needs_weights = pytest.mark.skipif(not shipped_checkpoint("handles").is_file(), reason="the shipped weights are not there")


def test_smoothing_by_hand():
    weights = np.array([[1.0, 0], [0, 1], [0, 1]])
    got = smooth_weights(weights, np.array([[0, 1]]), steps=1, share=0.5)
    np.testing.assert_allclose(got, [[0.5, 0.5], [0.5, 0.5], [0, 1]])


def test_trimming_by_hand():
    np.testing.assert_allclose(trim_weights(np.array([[0.6, 0.395, 0.005]])), [[0.6 / 0.995, 0.395 / 0.995, 0]], rtol=1e-6)


def test_small_loose_parts_get_one_weight_and_sleeves_do_not():
    body = trimesh.creation.box((1, 2, 1)).subdivide().subdivide()
    button = trimesh.creation.icosphere(2, 0.1).apply_translation([0, 0.5, 0.65])
    sleeve = trimesh.creation.box((0.6, 0.1, 0.1)).apply_translation([0.9, 0.5, 0])
    whole = trimesh.util.concatenate([body, button, sleeve])
    mesh = network_mesh(whole.vertices, whole.faces, 1500)
    place = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(place), 3))
    weights[:, 0] = 1
    on_button = np.linalg.norm(place - [0, 0.5, 0.65], axis=1) < 0.13
    on_sleeve = place[:, 0] > 0.59
    weights[on_button] = np.where(place[on_button, 1:2] > 0.55, [0, 0.4, 0.6], [0, 0, 1])
    weights[on_sleeve] = np.where(place[on_sleeve, :1] > 0.9, [0, 1, 0], [1, 0, 0])
    got = stiffen_parts(weights, mesh)
    assert np.ptp(got[on_button], axis=0).max() < 1e-9 and 0.7 < got[on_button][0, 2] < 1
    np.testing.assert_array_equal(got[~on_button], weights[~on_button])


@needs_weights
@pytest.mark.parametrize("name", ["person", "robot", "dog"])
def test_left_and_right_are_where_they_are(name):
    character = sample_character(name, 0.5)
    handles = predict_handles(character)
    np.testing.assert_allclose(handles.weights.sum(axis=1), 1, atol=1e-5)
    assert handles.features.shape == (448,)
    for part in ("elbow", "knee"):
        left, right = (handles.positions[HANDLE_NAMES.index(f"{side}_{part}"), 0] for side in ("left", "right"))
        assert left > 0.02 * character.height > -0.02 * character.height > right
    assert handles.positions[HANDLE_NAMES.index("head"), 1] > handles.positions[0, 1]


@needs_weights
def test_a_finer_tessellation_has_the_same_handles():
    character = sample_character("person", 0.5)
    mesh = trimesh.Trimesh(character.vertices, character.faces, process=False).subdivide()
    coarse, fine = predict_handles(character), predict_handles(Character("fine", mesh.vertices, mesh.faces))
    np.testing.assert_allclose(fine.positions, coarse.positions, atol=0.02 * character.height)
    np.testing.assert_allclose(mesh.vertices[: len(character.vertices)], character.vertices, atol=1e-6)
    assert np.abs(fine.weights[: len(character.vertices)] - coarse.weights).sum(axis=1).mean() < 0.15
