"""Hands are where things are, found by forward kinematics: 9 cm from the wrist along the hand."""

import numpy as np
import pytest
from palms import palms

from bunraku.gestures.contact import touched
from bunraku.gestures.perform import performed
from bunraku.gestures.places import things_file
from bunraku.gestures.play import gesture_motion
from bunraku.gestures.standing import AT
from bunraku.language.contact import Contact, contact_of


def made(text):
    return gesture_motion(touched(contact_of(text)))


def busy(text, side=1):
    """Where a hand is while it is far from where it hangs, shape (M, 3)."""
    there = palms(made(text))[:, side]
    return there[np.linalg.norm(there - there[0], axis=1) > 0.25]


@pytest.mark.parametrize("deed", things_file()["deeds"])
@pytest.mark.parametrize("hands", ["one", "both", "left"])
def test_every_deed_begins_and_ends_at_rest_and_no_hand_flies(deed, hands):
    motion = gesture_motion(touched(Contact(deed, hands, 1.0, "grip")))
    there = palms(motion)
    ends = [0] if deed == "sip" else [0, -1]  # a cup is held to the end
    np.testing.assert_allclose(there[ends, :, 1], 0.845, atol=0.06)
    assert np.linalg.norm(np.diff(there, axis=0), axis=2).max() < 0.2  # 4 m/s
    moved = np.ptp(there, axis=0).max(axis=1)
    assert moved[0] > 0.25 if hands == "left" or deed == "dodge" else moved[1] > 0.25


def test_a_dog_is_patted_at_its_head_with_the_palm_down_and_a_horse_higher():
    motion = made("pats a dog on the head")
    dog, horse = busy("pats a dog on the head"), busy("pats a horse")
    assert 0.6 < np.quantile(dog[:, 1], 0.2) < 0.8 and 1.1 < np.quantile(horse[:, 1], 0.2) < 1.35
    down = np.abs(np.diff(np.sign(np.diff(dog[:, 1])))).sum() / 2
    assert down >= 8  # up and down, again and again
    rotations, _ = motion.world()
    assert rotations[60, AT["right_wrist"]][1, 1] > 0.9  # the back of a hand at rest is up
    assert np.ptp(palms(motion)[:, 0], axis=0).max() < 0.5  # the left hand does nothing


def test_a_window_is_wiped_across_and_up_and_a_table_across_and_ahead():
    window, table = busy("wipes a window")[25:-25], busy("wipes a table")[25:-25]
    across, up, ahead = np.ptp(window, axis=0)
    assert min(across, up) > 2 * ahead and across > 0.25
    across, up, ahead = np.ptp(table, axis=0)
    assert min(across, ahead) > 2 * up and across > 0.25


def test_a_drawer_comes_near_and_goes_away_a_blind_comes_down_and_a_lid_goes_up():
    def way(text):
        moves = touched(contact_of(text)).keys
        first, last = (round(20 * moment) for moment in (moves[1][0], moves[-2][0]))
        return np.subtract(*palms(made(text))[[last, first], 1])

    assert way("pulls out the drawer")[2] < -0.15 < 0.15 < way("pushes the drawer shut")[2]
    assert way("pulls down the blind")[1] < -0.3 < 0.3 < way("lifts the lid")[1]
    assert way("slides the door open")[0] < -0.3  # to the right hand's own side


def test_curtains_are_parted_by_both_hands_and_a_door_is_swung_by_one():
    there = palms(made("opens the curtains"))
    apart = there[:, 0, 0] - there[:, 1, 0]
    assert apart[24:].max() > 1.0 and apart[18:30].min() < 0.4
    door = palms(made("opens the door"))
    assert np.ptp(door[:, 0], axis=0).max() < 0.45 < np.ptp(door[:, 1], axis=0).max()


def test_a_cup_goes_to_the_mouth_and_binoculars_to_the_eyes():
    head = made("sips tea").world()[1][:, AT["head"]]
    assert np.linalg.norm(palms(made("sips tea"))[:, 1] - head - [0, 0.02, 0.15], axis=1).min() < 0.1
    there = palms(made("looks through binoculars"))[60]
    assert (there[:, 1] > 1.6).all() and (there[:, 2] > 0.1).all()


def test_who_drives_and_who_rows_sits_and_rows_with_the_whole_trunk():
    for text in ("drives a car", "rows a boat"):
        height = made(text).world()[1][:, 0, 1]
        assert height[0] - height[60] > 0.4
    ahead = palms(made("rows a boat"))[40:-40, :, 2]
    assert (np.ptp(ahead, axis=0) > 0.45).all() and np.corrcoef(*ahead.T)[0, 1] > 0.9
    turned = palms(made("drives a car"))[40:-40, :, 1]
    assert np.corrcoef(*turned.T)[0, 1] < -0.9


def test_a_letter_is_held_out_with_the_palm_up():
    motion = made("hands a letter to somebody")
    there, rotations = palms(motion)[40, 1], motion.world()[0][40, AT["right_wrist"]]
    assert there[2] > 0.5 and 1.0 < there[1] < 1.4 and rotations[1, 1] < -0.7


def test_the_left_hand_does_what_the_right_one_does_in_the_mirror():
    left, right = (palms(made(f"presses the button with the {side} hand")) for side in ("left", "right"))
    np.testing.assert_allclose(left[:, 0] * [-1, 1, 1], right[:, 1], atol=0.06)  # all but the sway
    sip = palms(made("sips tea with the left hand"))
    assert sip[:, 0, 1].max() > 1.5 and sip[:, 1, 1].max() < 1.0


@pytest.mark.parametrize("seed", range(3))
def test_things_are_reached_however_it_is_performed(seed):
    motion = performed(touched(contact_of("strokes a cat")), 120, (), np.random.default_rng(seed))
    assert 0.3 < np.median(np.sort(palms(motion)[:, 1, 1])[:40]) < 0.65
