"""Bones that turn: forward kinematics, the way back from world turns, and skinning against its definition."""

import numpy as np
import pytest

from bunraku import CharacterError, MotionError, RigAnimation
from bunraku.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.skinning import skin_reference
from bunraku.geometry.rotations import matrix_from_axis_angle


@pytest.fixture(scope="module")
def character():
    return reference_body().character()


def swinging(character, frames=3, seed=0):
    random = np.random.default_rng(seed)
    bones = len(character.rig.names)
    turns = matrix_from_axis_angle(0.5 * random.normal(size=(frames, bones, 3)))
    return RigAnimation(character, turns, 0.05 * random.normal(size=(frames, bones, 3)), 20.0)


def test_identities_and_zeros_are_the_rest_pose(character):
    bones = len(character.rig.names)
    still = RigAnimation(character, np.tile(np.eye(3), (2, bones, 1, 1)), np.zeros((2, bones, 3)))
    assert np.abs(still.vertices() - character.vertices).max() < 1e-6
    turns, heads = still.world()
    assert np.allclose(turns, np.eye(3)) and np.allclose(heads, character.rig.positions)


def test_world_and_back(character):
    animation = swinging(character)
    again = RigAnimation.of_world(character, *animation.world(), 20.0)
    assert np.abs(again.rotations - animation.rotations).max() < 1e-6
    assert np.abs(again.translations - animation.translations).max() < 1e-6


def test_vertices_are_those_of_linear_blend_skinning(character):
    animation = swinging(character)
    want = skin_reference(character.vertices, character.rig.dense_weights(), animation.transforms())
    assert np.abs(animation.vertices() - want).max() < 1e-5
    assert np.abs(animation.animation().vertices([2]) - want[2:]).max() < 1e-5


def test_what_is_no_animation_is_refused(character):
    bones = len(character.rig.names)
    with pytest.raises(MotionError, match="shape"):
        RigAnimation(character, np.zeros((2, bones - 1, 3, 3)), np.zeros((2, bones, 3)))
    with pytest.raises(MotionError, match="not numbers"):
        RigAnimation(character, np.full((2, bones, 3, 3), np.nan), np.zeros((2, bones, 3)))
    with pytest.raises(MotionError, match="at least one frame"):
        RigAnimation(character, np.zeros((0, bones, 3, 3)), np.zeros((0, bones, 3)))
    with pytest.raises(CharacterError, match="no rig"):
        RigAnimation(
            Character("bare", character.vertices, character.faces), np.zeros((2, bones, 3, 3)), np.zeros((2, bones, 3))
        )
