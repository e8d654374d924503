"""Gestures made by code: hands are where their key poses say, feet stand, and sentences say what is done."""

import numpy as np
import pytest

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.language.actions import actions_of
from bunraku.language.understood import understood
from bunraku.synthetic.gestures.catalogue import GESTURES, STANDING
from bunraku.synthetic.gestures.play import gesture_motion
from bunraku.synthetic.gestures.pose import HANGING, Gesture, Hand, Pose, again

AT = {name: index for index, name in enumerate(JOINT_NAMES)}
KNEELING = ("kneel", "both knees", "propose")


def palms(motion):
    """Middle of each palm by forward kinematics: 9 cm from the wrist along the hand, which lies along x at rest."""
    rotations, places = motion.world()
    return {
        side: places[:, AT[f"{side}_wrist"]] + 0.09 * sign * rotations[:, AT[f"{side}_wrist"]][:, :, 0]
        for side, sign in (("left", 1), ("right", -1))
    }


def gesture(name):
    return next(one for one in GESTURES if one.name == name)


def test_a_palm_is_where_its_key_says_and_faces_that_way():
    hand = Hand((0.2, 1.4, 0.4), (0, 1, 0), (0, 0, 1))
    motion = gesture_motion(Gesture("stop", (), ((0.0, Pose()), (1.0, Pose(right=hand)), (2.0, Pose()))))
    rotations, _ = motion.world()
    there = palms(motion)
    sway = 0.03  # the chest moves while somebody stands
    np.testing.assert_allclose(there["right"][20], [-0.2, 1.4, 0.4], atol=sway)
    np.testing.assert_allclose(there["left"][20], [0.27, 0.845, 0.06], atol=sway)
    assert rotations[20, AT["right_wrist"]][:, 1] @ [0, 0, -1] > 0.95  # the back of a hand at rest is up
    assert np.ptp(there["right"], axis=0)[1] > 0.5 > np.ptp(there["left"], axis=0)[1] * 10


def test_claps_meet_and_part_as_often_as_said():
    motion = gesture_motion(gesture("clap"))
    there = palms(motion)
    away = np.linalg.norm(there["left"] - there["right"], axis=1)
    near = (away[1:-1] < away[:-2]) & (away[1:-1] <= away[2:]) & (away[1:-1] < 0.08)
    assert near.sum() == 8 and away[16:-16].max() > 0.2


@pytest.mark.parametrize("number", range(len(GESTURES)), ids=lambda number: f"{GESTURES[number].name}-{number}")
def test_every_gesture_is_whole(number):
    one = GESTURES[number]
    assert {actions_of(text) for text in one.texts} == {(one.name,)}
    for text in one.texts:
        found = understood(text)
        assert found.ok and not found.unknown
    motion = gesture_motion(one)
    rotations, places = motion.world()
    assert len(motion) == round(20 * one.seconds) + 1
    np.testing.assert_allclose(np.linalg.det(rotations.reshape(-1, 3, 3)), 1, atol=1e-5)
    for side in ("left", "right"):
        ankle = places[:, AT[f"{side}_ankle"]]
        assert ankle[:, 1].min() > 0.07
        if one.name not in (*KNEELING, "hop"):
            assert np.ptp(ankle, axis=0).max() < 0.01  # feet stand, however the pelvis sways
        assert np.linalg.norm(np.diff(palms(motion)[side], axis=0), axis=1).max() < 0.45  # 9 m/s, a fast punch
    ends = [palms(motion)["right"][frame] for frame in ((0,) if one.name in KNEELING else (0, -1))]
    np.testing.assert_allclose(ends, [[-0.27, 0.845, 0.06]] * len(ends), atol=0.05)
    if one.cycle is not None:
        start, stop = (round(20 * moment) for moment in one.cycle)
        assert 12 <= stop - start < len(motion)
        away = np.linalg.norm(palms(motion)["right"][stop] - palms(motion)["right"][start])
        assert away < 0.04  # all but the sway


def test_who_kneels_has_a_knee_on_the_ground_and_both_where_so_said():
    for name, count in (("kneel", 1), ("both knees", 2)):
        _, places = gesture_motion(gesture(name)).world()
        knees = places[-1, [AT["left_knee"], AT["right_knee"]], 1]
        assert (knees < 0.12).sum() == count and knees.min() > 0.02


def test_who_hops_is_in_the_air_with_both_feet_and_lands_on_one():
    _, places = gesture_motion(gesture("hop")).world()
    right, left = (places[20:60, AT[f"{side}_ankle"], 1] for side in ("right", "left"))
    assert left.min() > 0.35 and right.min() < 0.1 and right.max() > 0.2


def test_both_hands_hold_the_club():
    there = palms(gesture_motion(gesture("golf")))
    assert np.linalg.norm(there["left"] - there["right"], axis=1)[16:70].max() < 0.2


def test_standing_goes_on_without_a_stop():
    motion = gesture_motion(STANDING)
    _, places = motion.world()
    assert 0.004 < np.ptp(places[:, 0], axis=0).max() < 0.03
    assert len(motion) > 180 and np.ptp(places[:, AT["head"]], axis=0).max() > 0.01


def test_cycles_are_laid_evenly_between_two_rests():
    one, other = Pose(lean=(1, 0, 0)), Pose(lean=(2, 0, 0))
    keys, cycle = again([one, other], 0.5, 3, start=0.6, end=0.4)
    assert [round(time, 3) for time, _ in keys] == [0.0, 0.6, 0.85, 1.1, 1.35, 1.6, 1.85, 2.1, 2.5]
    assert keys[0][1].right == keys[-1][1].right == HANGING and keys[1][1] is one and keys[2][1] is other
    assert cycle == (0.6, 1.6)


def test_both_arms_keep_their_bones():
    body = reference_body()
    _, places = gesture_motion(gesture("violin")).world()
    for side in ("left", "right"):
        for one, two in ((f"{side}_shoulder", f"{side}_elbow"), (f"{side}_elbow", f"{side}_wrist")):
            length = np.linalg.norm(places[:, AT[one]] - places[:, AT[two]], axis=1)
            np.testing.assert_allclose(length, np.linalg.norm(body.joints[AT[one]] - body.joints[AT[two]]), atol=1e-4)
