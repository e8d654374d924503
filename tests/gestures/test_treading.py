"""Walks by the ground: steps, feet and arms, measured on the motion."""

import numpy as np
import pytest

from bunraku.gestures.play import gesture_motion
from bunraku.gestures.standing import AT
from bunraku.gestures.treading import read_treads, trodden
from bunraku.language.footing import Footing


def walk(ground, height=0.0):
    return gesture_motion(trodden(Footing(ground, height)))


def of(motion, joint):
    return motion.world()[1][:, AT[joint]]


def lift(motion):
    ankle = of(motion, "left_ankle")[:, 1]
    return np.ptp(ankle)


def speed(motion):
    return np.diff(of(motion, "pelvis")[:, 2]).mean() * motion.fps


def apart(motion):
    return (of(motion, "left_ankle") - of(motion, "right_ankle"))[:, 0].mean()


@pytest.mark.parametrize("ground", read_treads())
def test_feet_stand_where_they_are_put_and_nobody_stops(ground):
    motion = walk(ground)
    ankles = np.stack([of(motion, "left_ankle"), of(motion, "right_ankle")], axis=1)
    gone = np.diff(of(motion, "pelvis")[:, 2]) * motion.fps
    assert gone.min() > 0 and 0.2 < speed(motion) < 1.2
    step = np.linalg.norm(np.diff(ankles, axis=0), axis=2)
    assert (step.min(axis=1) < 0.03).all()  # one of both is on the ground
    low = ankles[..., 1].min(axis=1)
    assert low.max() < 0.2 and low.min() > 0.06
    assert np.abs(np.diff(ankles[..., 1], axis=0)).max() < 0.16


def test_deep_is_lifted_narrow_is_in_line_and_slippery_is_flat():
    usual = 0.15
    assert lift(walk("deep")) > 0.3 > usual > lift(walk("slippery"))
    assert abs(apart(walk("narrow"))) < 0.03 < 0.2 < apart(walk("deep"))
    assert speed(walk("hot")) > 2 * speed(walk("sharp"))


def test_arms_are_out_on_a_rope_and_ahead_in_the_dark():
    rope, dark = walk("narrow"), walk("dark")
    assert np.abs(of(rope, "left_wrist") - of(rope, "right_wrist"))[:, 0].min() > 1.2
    assert (of(dark, "left_wrist") - of(dark, "pelvis"))[:, 2].min() > 0.2


def test_trunks_lean_up_a_hill_and_back_down_it():
    def lean(motion):
        up = motion.world()[0][:, AT["spine3"], :, 1]
        return np.degrees(np.arctan2(up[:, 2], up[:, 1])).mean()

    assert lean(walk("uphill")) > 15 > -5 > lean(walk("downhill"))


def test_hands_on_a_cart_stay_at_its_height_ahead_of_the_pelvis():
    motion = walk("pushed", 1.1)
    for side in ("left", "right"):
        hand = of(motion, f"{side}_wrist") - of(motion, "pelvis") * [1, 0, 1]
        assert np.ptp(hand[:, 1]) < 0.03 and abs(hand[:, 1].mean() - 1.1) < 0.06 and hand[:, 2].min() > 0.2
