"""What a sentence plainly says, held against motions whose turns, hands and feet are made with known numbers."""

import numpy as np
import pytest
from moving_people import kick, person, ramp

from bunraku.diffusion.features import decode, encode, mirror
from bunraku.diffusion.generation import agreement as described
from bunraku.language.captions.phrases import mirror_words
from bunraku.language.parse import clause_of


def agreement(sentence, motion):
    return described.agreement(clause_of(sentence), motion)


def turning(degrees):
    return person(60, heading=ramp(60, 10, 50, np.radians(degrees)))


def raising(side):
    up = np.zeros((60, 3))
    up[:, 1] = ramp(60, 10, 30, 0.6)
    return person(60, hands={side: up + [0, -0.3, 0]})


MOTIONS = {
    "a person turns left": turning(90),
    "a person turns around": turning(-180),
    "a person makes a full turn to the right": turning(-360),
    "a person walks forward": person(60, speed=1.2, steps=0.3),
    "a person walks backwards": person(60, speed=0.8, course=np.pi, steps=0.2),
    "a person steps to the left": person(60, speed=0.4, course=np.pi / 2, steps=0.1),
    "a person kicks with the right leg": person(60, feet=kick(60, 20, "right")),
    "a person stands on the left leg": person(60, feet=kick(60, 20, "right")),
    "a person raises the left arm": raising("left"),
    "a person sits down": person(80, height=-ramp(80, 10, 40, 0.4)),
    "a person stands up from the chair": person(80, height=ramp(80, 10, 40, 0.4) - 0.4),
}


@pytest.mark.parametrize("sentence", MOTIONS)
def test_a_true_sentence_agrees_as_its_mirror_image_does(sentence):
    motion = MOTIONS[sentence]
    assert agreement(sentence, motion) > 0.7
    mirrored = decode(mirror(encode(motion)))
    assert agreement(mirror_words(sentence), mirrored) == pytest.approx(agreement(sentence, motion), abs=0.02)


@pytest.mark.parametrize("sentence", [one for one in MOTIONS if mirror_words(one) != one])
def test_the_other_side_does_not(sentence):
    assert agreement(mirror_words(sentence), MOTIONS[sentence]) < -0.5


@pytest.mark.parametrize(
    ("sentence", "motion"),
    [
        ("a person turns left", turning(300)),
        ("a person turns around", turning(60)),
        ("a person walks backwards", MOTIONS["a person walks forward"]),
        ("a person walks forward", person(60)),
        ("a person walks as if very tired", person(60)),
        ("a person runs in a circle", person(60, speed=0.1)),
        ("a person sits down", person(80)),
    ],
)
def test_what_is_not_done_or_too_much_of_it(sentence, motion):
    assert agreement(sentence, motion) < 0.25


def test_who_walks_goes_somewhere_but_not_in_place():
    assert agreement("a person walks as if very tired", person(60, speed=0.4, steps=0.1)) == 1
    assert agreement("a person walks in place", person(60)) is None
    assert agreement("a person walks and stops", person(60)) is None


def test_who_sits_down_stood_before():
    seated = person(80, height=np.full(80, -0.4))
    assert agreement("a person sits down", seated) < 0.25 < agreement("a person sits on a chair", seated)


@pytest.mark.parametrize("sentence", ["a person dances", "a person kicks", "a person turns left, then turns right"])
def test_nothing_is_said_of_what_is_not_plain(sentence):
    assert agreement(sentence, turning(90)) is None


@pytest.mark.parametrize(
    ("sentence", "stands"),
    [
        ("a person sits down", True),
        ("someone takes a seat", True),
        ("a person lies down on the floor", True),
        ("a person sits on a chair", True),
        ("a person is sitting", False),
        ("a person stands up", False),
        ("a person walks", False),
    ],
)
def test_who_goes_down_starts_standing(sentence, stands):
    assert ("goes down" in clause_of(sentence).traits) is stands


@pytest.mark.parametrize(
    ("sentence", "straight"),
    [("walks on", True), ("a person runs straight on", True), ("a person walks forward", True), ("walks", False),
     ("walks on the hands", False), ("walks on in a circle", False), ("turns left and walks on", False)],
)  # fmt: skip
def test_who_goes_on_goes_straight(sentence, straight):
    assert clause_of(sentence).straight is straight


def test_who_walks_does_so_for_most_of_the_time():
    stops = person(80, speed=np.where(np.arange(80) < 40, 1.2, 0.0), steps=0.3)
    assert agreement("a person walks across the room", stops) < 0.5
    assert agreement("a person walks forward", stops) < 0.5
    assert agreement("a person walks forward", person(80, speed=0.6, steps=0.2)) == 1


def test_a_circle_is_turned_evenly():
    even = person(80, speed=1.0, steps=0.3, heading=ramp(80, 0, 80, np.radians(330)))
    odd = person(80, speed=1.0, steps=0.3, heading=ramp(80, 0, 26, np.radians(330)))
    assert agreement("a person walks in a circle", odd) < 0.5 < agreement("a person walks in a circle", even)


def test_a_comma_within_one_thing_ends_no_check():
    assert agreement("a person raises the left arm, slowly", raising("right")) < 0
