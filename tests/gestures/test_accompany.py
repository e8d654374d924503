"""Pelvis, trunk and head go with the hands of who stands."""

import numpy as np

from bunraku.gestures.accompany import accompanied
from bunraku.gestures.catalogue import gestures
from bunraku.gestures.tracks import Tracks


def tracks(name):
    return Tracks.of(next(one for one in gestures() if one.name == name).keys)


def free(count, value=True):
    return {side: np.full(count, value) for side in ("left", "right")}


def test_a_hand_that_goes_ahead_takes_its_shoulder_along_and_the_head_looks_on():
    before = tracks("shake hands")
    count = len(before.turn)
    after = accompanied(before, np.ones(count), free(count))
    there = ~before.hands["right"].rests
    assert (after.turn - before.turn)[there].max() > 5  # to the left: the right shoulder is ahead
    assert (after.lean - before.lean)[there, 1].max() > 5
    assert (after.head - before.head)[there, 1].min() < -5
    assert np.abs((after.turn - before.turn)[~there]).max() == 0


def test_a_free_hand_stays_where_it_is_in_the_world():
    before = tracks("shake hands")
    count = len(before.turn)
    after = accompanied(before, np.ones(count), free(count))
    turned = np.radians((after.turn - before.turn) + (after.lean - before.lean)[:, 1])
    x, z = after.hands["right"].palm[:, 0] * -1, after.hands["right"].palm[:, 2]
    world = np.stack([x * np.cos(turned) + z * np.sin(turned), z * np.cos(turned) - x * np.sin(turned)], axis=1)
    np.testing.assert_allclose(world[:, 0], before.hands["right"].palm[:, 0] * -1, atol=1e-6)
    np.testing.assert_allclose(world[:, 1], before.hands["right"].palm[:, 2], atol=1e-6)


def test_hands_that_touch_go_with_the_body_and_both_alike_turn_nothing():
    claps = tracks("clap")
    count = len(claps.turn)
    after = accompanied(claps, np.ones(count), free(count, False))
    np.testing.assert_allclose(after.turn, claps.turn, atol=1e-9)
    np.testing.assert_array_equal(after.hands["right"].palm, claps.hands["right"].palm)
