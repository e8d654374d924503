"""From the network's weights to those of a character: smoothing, loose parts, trimming, and the shipped predictor as a
whole.
"""

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_MIRROR, HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.handles.predict import mesh_feature, predict_handles, smooth_weights, trim_weights
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.synthetic.samples import make_sample

needs_weights = pytest.mark.skipif(
    not shipped_checkpoint("handles").is_file(), reason="the shipped weights are not there"
)


def test_smoothing_by_hand():
    weights = np.array([[1.0, 0], [0, 1], [0, 1]])
    got = smooth_weights(weights, np.array([[0, 1]]), steps=1, share=0.5)
    np.testing.assert_allclose(got, [[0.5, 0.5], [0.5, 0.5], [0, 1]])


def test_trimming_by_hand():
    np.testing.assert_allclose(
        trim_weights(np.array([[0.6, 0.395, 0.005]])), [[0.6 / 0.995, 0.395 / 0.995, 0]], rtol=1e-6
    )


@needs_weights
@pytest.mark.parametrize("name", ["person", "robot", "dog"])
def test_left_and_right_are_where_they_are(name):
    character = make_sample(name, 0.5)
    handles = predict_handles(character)
    np.testing.assert_allclose(handles.weights.sum(axis=1), 1, atol=1e-5)
    assert handles.features.shape == (448,)
    for part in ("elbow", "knee"):
        left, right = (handles.positions[HANDLE_NAMES.index(f"{side}_{part}"), 0] for side in ("left", "right"))
        assert left > 0.02 * character.height > -0.02 * character.height > right
    assert handles.positions[HANDLE_NAMES.index("head"), 1] > handles.positions[0, 1]


@needs_weights
def test_a_finer_tessellation_has_the_same_handles():
    character = make_sample("person", 0.5)
    mesh = trimesh.Trimesh(character.vertices, character.faces, process=False).subdivide()
    coarse, fine = predict_handles(character), predict_handles(Character("fine", mesh.vertices, mesh.faces))
    used = coarse.weights.mean(axis=0) > 0.003  # a handle that moves next to nothing may stand anywhere
    assert used.sum() > 15
    np.testing.assert_allclose(fine.positions[used], coarse.positions[used], atol=0.02 * character.height)
    np.testing.assert_allclose(mesh.vertices[: len(character.vertices)], character.vertices, atol=1e-6)
    assert np.abs(fine.weights[: len(character.vertices)] - coarse.weights).sum(axis=1).mean() < 0.15


@needs_weights
def test_vertices_at_one_place_have_equal_weights():
    character = make_sample("person", 0.5)
    whole = predict_handles(character)
    soup = Character(
        "soup", character.vertices[character.faces].reshape(-1, 3), np.arange(3 * len(character.faces)).reshape(-1, 3)
    )
    got = predict_handles(soup).weights
    corner = character.faces.reshape(-1)
    first = np.unique(corner, return_index=True)[1]
    np.testing.assert_array_equal(got, got[first][np.searchsorted(np.unique(corner), corner)])
    np.testing.assert_allclose(got, whole.weights[corner], atol=1e-3)


@needs_weights
def test_the_feature_alone_is_that_of_the_prediction():
    character = make_sample("dog", 0.4)
    np.testing.assert_allclose(mesh_feature(character), predict_handles(character).features, atol=1e-5)


@needs_weights
def test_a_mirrored_character_has_mirrored_weights():
    character = make_sample("dragon", 0.4)
    flipped = Character("flipped", character.vertices * [-1, 1, 1], character.faces[:, ::-1])
    got = predict_handles(flipped).weights[:, list(HANDLE_MIRROR)]
    assert np.abs(got - predict_handles(character).weights).sum(axis=1).mean() < 0.1
