"""Heads of lying bodies stay out of the ground: the sample dog bends its trunk far down."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.anatomy.joints import attach_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.front import Front
from bunraku_lab.synthetic.samples import make_sample

FRAMES = 41


@pytest.fixture(scope="module")
def dog():
    return RigParts.of(make_sample("dog", rigged=True))


def bowed(angle: float) -> HandleMotion:
    """The root tilts down by half of an angle and the trunk by the other half, most in the middle of the clip [rad]."""
    half = 0.5 * angle * np.sin(np.pi * np.arange(FRAMES) / (FRAMES - 1))
    turns = matrix_from_axis_angle(half[:, None] * np.array([1.0, 0, 0]))
    rotations = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face"):
        rotations[:, HANDLE_NAMES.index(name)] = turns
    return HandleMotion(np.zeros((FRAMES, 30, 3)), rotations, np.zeros((FRAMES, 3)), turns, 20.0).of_own_body()


def head_heights(dog, motion: HandleMotion, rotations: np.ndarray) -> np.ndarray:
    """Of the lowest point of the head over the ground, over the height, shape (N,)."""
    turned, translations = attach_joints(rotations, dog.handles, dog.joints)
    posed = HandleMotion(translations, turned, np.zeros((FRAMES, 3)), motion.root_rotation, 20.0)
    held = dog.handles.weights[:, HANDLE_NAMES.index("head")] > 0.5
    character = dog.character
    heights = skin(character.vertices[held], dog.handles.weights[held], posed.transforms(dog.handles.positions))[..., 1]
    return (heights.min(axis=1) - character.vertices[:, 1].min()) / character.height


def test_a_head_that_would_sink_is_kept_above_the_ground(dog):
    motion = bowed(np.radians(150))
    before = head_heights(dog, motion, motion.rotations)
    moved, rotations = Front().raised(motion, motion.rotations, dog.anatomy)
    after = head_heights(dog, moved, rotations)
    assert before.min() < -0.1 and after.min() > -Front().sink - 0.01
    assert after.min() < 0.6 * after.max()  # it still bows
    np.testing.assert_allclose(rotations[[0, -1]], motion.rotations[[0, -1]], atol=1e-3)


def test_a_head_above_the_ground_is_left_alone(dog):
    motion = bowed(np.radians(20))
    moved, rotations = Front().raised(motion, motion.rotations, dog.anatomy)
    assert moved is motion and rotations is motion.rotations
