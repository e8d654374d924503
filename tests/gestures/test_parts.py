"""Gestures at another part of the body: the hand is there, and moves along the surface as it does at its own."""

import numpy as np
import pytest

from bunraku.gestures.catalogue import gestures, read_parts
from bunraku.gestures.parts import at_part, part_in
from bunraku.gestures.play import gesture_motion
from bunraku.gestures.pose import Pose
from bunraku.gestures.standing import AT


def gesture(name):
    return next(one for one in gestures() if one.name == name)


def wrist_from(name, part, joint):
    """Distance of the right wrist from a joint in the midst of a gesture at a part [m]."""
    one = at_part(gesture(name), part)
    positions = gesture_motion(one).world()[1]
    middle = slice(round(20 * 1.0), round(20 * (one.seconds - 0.9)))
    return np.linalg.norm(positions[middle, AT["right_wrist"]] - positions[middle, AT[joint]], axis=1)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("scratches his chin", "chin"),
        ("touches the back of the head", "back-head"),
        ("touches the back", "back"),
        ("a person rubs the back of her neck", "back-neck"),
        ("pats his left knee", "knee"),
    ],
)
def test_the_longest_words_name_the_part(text, name):
    found = part_in(text)
    assert found is not None and found.name == name
    assert set(found.words) <= set(text.split())


def test_nothing_is_named_that_no_hand_reaches():
    assert part_in("scratches the door") is None
    assert part_in("touches the toes") is None


@pytest.mark.parametrize("name", ["scratch", "touch", "rub"])
def test_the_hand_is_at_the_part(name):
    assert wrist_from(name, "knee", "right_knee").max() < 0.25 < wrist_from(name, "knee", "head").min()
    assert wrist_from(name, "shoulder", "left_shoulder").max() < 0.3
    assert wrist_from(name, "chin", "neck").max() < 0.3
    assert wrist_from(name, "thigh", "right_hip").max() < 0.45


def test_it_moves_along_the_surface_and_rests_before_and_after():
    own, chin = gesture("scratch"), at_part(gesture("scratch"), "chin")
    assert chin.keys[0][1] == chin.keys[-1][1] == Pose()
    assert [time for time, _ in chin.keys] == [time for time, _ in own.keys]
    moved = np.subtract(chin.keys[1][1].right.palm, chin.keys[2][1].right.palm)
    before = np.subtract(own.keys[1][1].right.palm, own.keys[2][1].right.palm)
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(before))
    out = np.array(chin.keys[1][1].right.faces) / np.linalg.norm(chin.keys[1][1].right.faces)
    assert abs(moved @ out) < 0.6 * np.linalg.norm(moved)


def test_every_part_can_be_reached():
    for name in read_parts():
        positions = gesture_motion(at_part(gesture("touch"), name)).world()[1]
        there = at_part(gesture("touch"), name).keys[1][1].right
        frame = round(20 * 0.8)
        if there.on == "chest":  # which hardly moves: the palm is 9 cm from the wrist
            palm = np.array(there.palm) * [-1, 1, 1]
            assert np.linalg.norm(positions[frame, AT["right_wrist"]] - palm) < 0.16, name
