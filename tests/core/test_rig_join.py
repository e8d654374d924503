"""Animations of one rig in a row: no jump at the joins, and each goes on where the one before it ends."""

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.rig_join import end_to_start
from bunraku.geometry.rotations import matrix_from_axis_angle

FPS = 20.0


def walking(character, way, turn, frames=21):
    """One that goes a way [m] with an arm that swings, and turns about +Y [rad]."""
    turns, moves = np.zeros((frames, 22, 3)), np.zeros((frames, 22, 3))
    share = np.linspace(0, 1, frames)[:, None]
    turns[:, JOINT_NAMES.index("left_shoulder"), 0] = np.sin(3 * share[:, 0])
    turns[:, 0, 1] = turn * share[:, 0]
    moves[:, 0] = share * way
    return RigAnimation(character, matrix_from_axis_angle(turns), moves, FPS)


def test_each_goes_on_where_the_one_before_ends():
    body = reference_body().character()
    first, second = walking(body, [0, 0, 2], np.pi / 2), walking(body, [0, 0, 1], 0.0)
    whole = end_to_start([first, second])
    assert len(whole) == len(first) + len(second) - 1
    places = whole.world()[1]
    assert np.abs(places[: len(first)] - first.world()[1]).max() < 1e-5
    # A quarter to the left, so the second one's way along +Z is along +X.
    assert np.allclose(places[-1, 0] - places[len(first) - 1, 0], [1, 0, 0], atol=1e-3)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1).max(axis=1)
    assert steps[len(first) - 2 : len(first) + 8].max() < 2.0 * steps[: len(first) - 1].max()


def test_one_alone_stays_as_it_is():
    body = reference_body().character()
    first = walking(body, [1, 0, 2], 1.0)
    whole = end_to_start([first])
    assert np.array_equal(whole.rotations, first.rotations) and np.array_equal(whole.translations, first.translations)
