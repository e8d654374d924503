"""Hands go to the places that a sentence names, found by forward kinematics: 9 cm from the wrist along the hand."""

import numpy as np
import pytest
from palms import palms

from bunraku.gestures.handling import handled
from bunraku.gestures.perform import performed
from bunraku.gestures.places import read_places
from bunraku.gestures.play import gesture_motion
from bunraku.language.handling import Handling, Place, Station, handling_of
from bunraku.language.lexicon.tables import lexicon


def at_stations(text, motion=None):
    """Both palms in the middle of the stay at each station of a sentence, shape (S, 2, 3)."""
    gesture = handled(handling_of(text))
    there = palms(gesture_motion(gesture) if motion is None else motion)
    keys = gesture.keys
    stays = [(a[0] + b[0]) / 2 for a, b in zip(keys, keys[1:], strict=False) if a[1] == b[1]]
    return there[[round(20 * moment) for moment in stays]]


HEIGHTS = {
    "floor": (0.1, 0.3), "low": (0.4, 0.6), "table": (0.85, 1.1), "chest": (1.1, 1.4), "high": (1.6, 1.95),
    "overhead": (1.9, 2.2),
}  # fmt: skip


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize("way", ["", "left", "right"])
@pytest.mark.parametrize("hands", ["both", "left", "right"])
def test_hands_reach_every_place(height, way, hands):
    put = Handling((Station("hold", Place("chest")), Station("put", Place(height, way))), hands, True)
    gesture = handled(put)
    there = palms(gesture_motion(gesture))[round(20 * (gesture.keys[2][0] + 0.15))]
    used = {"both": [0, 1], "left": [0], "right": [1]}[hands]
    low, high = HEIGHTS[height]
    assert (there[used, 1] > low).all() and (there[used, 1] < high).all()
    aside = there[used, 0].mean()
    if height != "overhead":
        assert {"": abs(aside) < 0.12, "left": aside > 0.28, "right": aside < -0.28}[way]
    assert set(HEIGHTS) == set(read_places()) == set(lexicon().heights)


def test_a_box_goes_from_the_floor_to_the_left_and_over_the_head():
    floor, chest, left = at_stations("picks up a box from the floor and puts it on a table to the left")
    assert floor[:, 1].max() < 0.3 and abs(floor[:, 0].mean()) < 0.1
    assert left[:, 0].mean() > 0.3 and left[:, 1].min() > 0.85
    for both in (floor, chest, left):  # held between the palms
        assert 0.25 < np.linalg.norm(both[0] - both[1]) < 0.45
    *_, over = at_stations("picks up a box with two hands and lifts it over the head")
    assert over[:, 1].min() > 1.9


def test_one_hand_does_it_and_the_other_stays_down():
    *_, high = at_stations("a person takes a cup with the left hand and puts it on a shelf")
    assert high[0, 1] > 1.6 and high[1, 1] < 1.0


def test_what_is_held_is_held_to_the_end_and_what_is_put_down_is_let_go_of():
    held = palms(gesture_motion(handled(handling_of("picks up a box with two hands"))))
    assert held[-1, :, 1].min() > 1.1 > held[0, :, 1].max()
    gone = palms(gesture_motion(handled(handling_of("puts a box on the floor"))))
    assert gone[0, :, 1].min() > 1.1 and gone[-1, :, 1].max() < 1.0


def test_weights_go_up_again_and_again():
    height = palms(gesture_motion(handled(handling_of("lifts heavy weights"))))[..., 1].mean(axis=1)
    assert ((height[1:] > 0.8) & (height[:-1] <= 0.8)).sum() >= 3


@pytest.mark.parametrize("seed", range(3))
def test_places_are_reached_however_it_is_performed(seed):
    gesture = handled(handling_of("moves a box from the floor on the left to the shelf"))
    there = palms(performed(gesture, 120, (), np.random.default_rng(seed)))
    low = there[there[..., 1].mean(axis=1).argmin()]
    assert low[:, 1].max() < 0.3 and low[:, 0].mean() > 0.28
    assert there[..., 1].mean(axis=1).max() > 1.6
