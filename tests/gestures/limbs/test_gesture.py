"""Limbs are seen where a sentence says, in positions of joints."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.gestures.catalogue import gestures
from bunraku.gestures.limbs.composed import in_stance
from bunraku.gestures.limbs.gesture import limb_gesture
from bunraku.gestures.play import gesture_motion
from bunraku.gestures.standing import AT
from bunraku.language.limbs.posing import Stance, posing_of


def joints(predicate):
    """Positions (N, 22, 3) and world rotations (N, 22, 3, 3) through the gesture of a sentence."""
    rotations, positions = gesture_motion(limb_gesture(posing_of(predicate))).world()
    return positions, rotations


def at(positions, name):
    return positions[:, AT[name]]


def test_an_arm_to_the_side_at_the_height_of_the_shoulder():
    positions, _ = joints("raises the left arm to the side to shoulder height and holds it")
    wrist, shoulder = at(positions, "left_wrist")[-1], at(positions, "left_shoulder")[-1]
    assert abs(wrist[1] - shoulder[1]) < 0.1 and wrist[0] - shoulder[0] > 0.45
    assert at(positions, "left_wrist")[0, 1] < shoulder[1] - 0.4  # it hung before
    assert (at(positions, "right_wrist")[:, 1] < 1.1).all()


def test_more_and_less():
    def rise(word):
        positions, _ = joints(f"raises the right arm {word} forward and holds it")
        return at(positions, "right_wrist")[-1, 1]

    assert rise("slightly") < rise("straight") - 0.2


def test_a_leg_goes_back_and_forth_on_one_side():
    positions, _ = joints("swings the left leg back and forth")
    left, right = (at(positions, f"{side}_ankle") for side in ("left", "right"))
    assert left[:, 2].max() > 0.35 and left[:, 2].min() < -0.3
    assert np.ptp(right, axis=0).max() < 0.05
    crossings = np.diff(np.sign(left[:, 2])) != 0
    assert crossings.sum() >= 5


def test_who_stands_with_crossed_legs_stands():
    positions, _ = joints("stands with legs crossed")
    left, right = (at(positions, f"{side}_ankle") for side in ("left", "right"))
    assert (left[:, 0] < right[:, 0]).all() and at(positions, "pelvis")[:, 1].min() > 0.9


@pytest.mark.parametrize(
    ("stance", "least", "most"),
    [("stands", 0.9, 1.1), ("sits on a chair", 0.45, 0.65), ("kneels", 0.4, 0.6), ("squats", 0.5, 0.7),
     ("sits on the floor", 0.05, 0.2), ("lies on the back", 0.05, 0.2), ("lies on the belly", 0.05, 0.2)],
)  # fmt: skip
def test_both_arms_go_to_the_sides_in_any_stance(stance, least, most):
    positions, rotations = joints(f"{stance} with the arms stretched out to the sides")
    assert least < at(positions, "pelvis")[:, 1].min() and at(positions, "pelvis")[:, 1].max() < most
    for side, sign in (("left", 1), ("right", -1)):
        out = at(positions, f"{side}_wrist") - at(positions, f"{side}_shoulder")
        across = sign * rotations[:, AT["spine3"], :, 0]
        assert ((out * across).sum(axis=1) > 0.4).all()
    assert positions[..., 1].min() > -0.05


@pytest.mark.parametrize(
    "sentence", ["bends forward with the hands on the knees", "sits on a chair with the hands on the knees"]
)
def test_hands_are_on_the_knees(sentence):
    positions, _ = joints(sentence)
    away = [
        np.linalg.norm(at(positions, f"{side}_wrist") - at(positions, f"{side}_knee"), axis=1)
        for side in ("left", "right")
    ]
    assert np.max(away, axis=0).min() < 0.22


def test_head_and_trunk_go_to_their_sides():
    _, rotations = joints("leans to the left with the head turned to the right")
    chest, head = rotations[:, AT["spine3"]], rotations[:, AT["head"]]
    assert chest[:, 0, 1].max() > 0.25  # its up axis, towards +x, the body's left
    assert (np.arctan2(head[:, 0, 2], head[:, 2, 2]) < -0.5).any()


def test_a_knee_is_lifted_to_the_height_that_is_said():
    positions, _ = joints("lifts the right knee to hip height and holds it")
    assert abs(at(positions, "right_knee")[-1, 1] - at(positions, "right_hip")[-1, 1]) < 0.08
    assert at(positions, "pelvis")[-1, 0] > 0.05  # over the left foot


def test_alternately_is_one_side_after_the_other():
    positions, _ = joints("lifts the knees alternately")
    left, right = (at(positions, f"{side}_knee")[:, 1] for side in ("left", "right"))
    assert left.max() > 0.8 and right.max() > 0.8 and np.minimum(left, right).max() < 0.7


def test_a_gesture_of_the_hands_in_a_stance():
    clap = next(one for one in gestures() if one.name == "clap")
    _, standing = gesture_motion(clap).world()
    _, seated = gesture_motion(in_stance(clap, Stance("chair"))).world()
    assert at(standing, "pelvis")[:, 1].min() > 0.95 and at(seated, "pelvis")[:, 1].max() < 0.7
    for positions in (standing, seated):
        away = np.linalg.norm(at(positions, "left_wrist") - at(positions, "right_wrist"), axis=1)
        assert away.min() < 0.2
    hop = next(one for one in gestures() if one.name == "hop")
    assert in_stance(hop, Stance("chair")) is hop


def test_who_lies_down_sits_before():
    positions, _ = joints("lies down on the back and raises both arms")
    pelvis, head = at(positions, "pelvis")[:, 1], at(positions, "head")[:, 1]
    assert pelvis[0] > 0.95 and (head > 0.5)[pelvis < 0.2].any() and head[-1] < 0.35


def test_a_foot_that_is_held_comes_to_the_hand():
    positions, rotations = joints("holds the left foot with the left hand")
    away = np.linalg.norm(at(positions, "left_wrist") - at(positions, "left_ankle"), axis=1)
    assert away.max() < 0.3 and at(positions, "left_ankle")[:, 1].min() > 0.4
    assert rotations[:, AT["spine3"], 1, 1].min() > 0.75  # upright
