"""Words for motions whose path, turns, jumps and hands are made with known numbers."""

import os
from pathlib import Path

import numpy as np
import pytest
from moving_people import FPS, kick, person, ramp

from bunraku.generation.features import decode, encode, mirror
from bunraku.generation.verifier import Track
from bunraku.language.captions import conjugate, mirror_words
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.description.events import find_punches, find_seats
from bunraku_lab.description.phrases import Phrase, runs
from bunraku_lab.description.wording import chain, describe, inside, sentences


def said(motion, human=True):
    return [phrase.texts[0] for phrase in describe(motion, human) if phrase.kind != "still"]


def raised(frames, start, side, top=0.6, wave=0.0):
    """Offsets of a hand that rises from hanging within a second and stays; a wave from 0.3 s later."""
    sign = 1 if side == "left" else -1
    share = np.clip((np.arange(frames) - start) / 16, 0, 1)[:, None]
    offsets = np.array([-0.5 * sign, -0.7, 0]) * (1 - share) + np.array([-0.35 * sign, top, 0]) * share
    later = np.clip(np.arange(frames) - start - 22, 0, None) / FPS
    offsets[:, 0] += wave * np.sin(2 * np.pi * 2 * later)
    return {side: offsets}


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        (person(60, 1.2, steps=0.3), "{walk} forward"),
        (person(60, 0.55, steps=0.25), "{walk} forward slowly"),
        (person(60, 1.8, steps=0.35), "{walk} forward quickly"),
        (person(60, 3.0, steps=0.45), "{run} forward"),
        (person(60, 4.6, steps=0.5), "{run} forward quickly"),
        (person(60, 1.0, course=np.pi, steps=0.3), "{walk} backwards"),
        (person(60, 0.8, course=np.pi / 2), "{move} sideways to the left"),
        (person(60, 0.8, course=-np.pi / 2), "{move} sideways to the right"),
        (person(60, 1.2), "{move} forward"),  # feet that do not step: neither walking nor running is sure
    ],
)
def test_direction_gait_and_speed(motion, words):
    assert said(motion) == [words]


@pytest.mark.parametrize(
    ("degrees", "words"),
    [
        (45, None),
        (90, "{turn} left"),
        (-90, "{turn} right"),
        (180, "{turn} around to the left"),
        (-180, "{turn} around to the right"),
        (360, "{make} a full turn to the left"),
        (-800, "{spin} around to the right"),
    ],
)
def test_turns_with_their_side_and_amount(degrees, words):
    motion = person(200, heading=ramp(200, 30, 30 + max(20, abs(degrees) // 6), np.radians(degrees)))
    assert said(motion) == ([words] if words else [])


@pytest.mark.parametrize(("sign", "side", "clock"), [(1, "left", "counterclockwise"), (-1, "right", "clockwise")])
def test_a_circle_and_a_part_of_it(sign, side, clock):
    heading = sign * np.linspace(0, 2 * np.pi, 160)
    (circle,) = describe(person(160, 1.2, heading=heading, steps=0.3))
    assert circle.texts[0] == f"{{walk}} in a circle to the {side}" and f"{{walk}} {clock} in a circle" in circle.texts
    assert sentences([circle], 40, 120)[0] == f"walks in a curve to the {side}"
    (curve,) = describe(person(60, 1.2, heading=heading[:60], steps=0.3))
    assert curve.texts[0] == f"{{walk}} in a curve to the {side}" and curve.manner == (f"in a curve to the {side}",)


def jumps(starts, top=0.3, frames=None):
    """Crouches, then flies for half a second, from each of these frames."""
    frames = frames or starts[-1] + 30
    lift, height = np.zeros(frames), np.zeros(frames)
    for start in starts:
        share = np.clip((np.arange(frames) - start) / 10, 0, 1)
        lift += 4 * top * share * (1 - share)
        height -= 0.12 * np.exp(-(((np.arange(frames) - start + 5) / 3) ** 2))
    return lift, height


@pytest.mark.parametrize(("count", "often"), [(1, ""), (2, " twice"), (3, " three times"), (4, " four times")])
def test_jumps_are_counted(count, often):
    lift, height = jumps([20 + 30 * index for index in range(count)])
    motion = person(len(lift), lift=lift, height=height)
    phrases = describe(motion)
    assert [phrase.kind for phrase in phrases].count("jump") == count
    assert f"jumps{often}" in " ".join(sentences(phrases, 0, len(motion)))


@pytest.mark.parametrize("side", ["left", "right"])
def test_hands_and_feet_with_their_side_and_height(side):
    assert said(person(60, feet=kick(60, 20, side))) == [f"{{kick}} with the {side} foot"]
    assert said(person(60, feet=kick(60, 20, side, high=1.15))) == [f"{{kick}} high with the {side} foot"]
    assert said(person(60, feet=kick(60, 20, side, high=0.2))) == []
    assert said(person(80, hands=raised(80, 20, side))) == [f"{{raise}} the {side} hand above the head"]
    assert said(person(80, hands=raised(80, 20, side, top=0.1))) == []
    both = raised(80, 20, "left") | raised(80, 22, "right")
    assert said(person(80, hands=both)) == ["{raise} both hands above the head"]
    words = said(person(110, hands=raised(110, 10, side, top=0.15, wave=0.12)))
    assert words == [f"{{wave}} with the {side} hand"]


def test_squats_are_counted_and_a_half_one_is_not_told():
    height = np.zeros(160)
    for start in (20, 70, 120):
        height -= 0.45 * np.sin(np.pi * np.clip((np.arange(160) - start) / 30, 0, 1))
    phrases = describe(person(160, height=height))
    assert [phrase.kind for phrase in phrases if phrase.kind != "still"] == ["bend"] * 3
    assert "does a squat three times" in sentences(phrases, 0, 160)
    assert not any("squat" in one for one in sentences(phrases, 30, 60))
    # a crop that cuts a repeat has no number for it
    assert "does a squat more than once" in sentences(phrases, 0, 135)


def test_the_order_is_kept_and_a_crop_has_only_its_own_words():
    frames = 200
    heading = ramp(frames, 20, 40, np.pi / 2) + ramp(frames, 70, 90, np.pi / 2)
    speed = np.where(np.arange(frames) > 110, 3.0, 0.0)
    motion = person(frames, speed, heading=heading, steps=0.45)
    phrases = describe(motion)
    assert sentences(phrases, 0, frames)[0] == "turns left twice, then runs forward"
    assert sentences(phrases, 50, frames)[0] == "turns left, then runs forward"
    assert sentences(phrases, 120, frames)[0] == "runs forward"
    assert not any("turn" in one or "run" in one for one in sentences(phrases, 30, 80))
    assert sentences([], 0, frames) == []


def test_creatures_get_directions_and_turns_only():
    lift, height = jumps([20])
    assert said(person(50, lift=lift, height=height), human=False) == []
    assert said(person(60, 3.0, steps=0.45), human=False) == ["{move} forward"]
    assert said(person(100, heading=ramp(100, 30, 50, -np.pi / 2)), human=False) == ["{turn} right"]


def mirrored_pairs(motion):
    features = encode(motion)
    one, other = describe(decode(features)), describe(decode(mirror(features)))

    def key(phrase, change):
        return (
            phrase.start, phrase.stop, phrase.kind,
            *(tuple(map(change, words)) for words in (phrase.texts, phrase.part, phrase.manner)),
        )  # fmt: skip

    assert [key(phrase, mirror_words) for phrase in one] == [key(phrase, str) for phrase in other]
    length = len(motion)
    for start, stop in ((0, length), (length // 3, length), (0, length // 2)):
        assert [mirror_words(one) for one in sentences(one, start, stop)] == sentences(other, start, stop)
    return len(one)


def test_a_mirrored_motion_has_exactly_the_mirrored_words():
    rng = np.random.default_rng(0)
    told = 0
    for _ in range(25):
        frames = int(rng.integers(40, 200))
        heading = ramp(frames, 10, 35, rng.uniform(-4, 4)) + ramp(
            frames, frames // 2, frames // 2 + 20, rng.uniform(-4, 4)
        )
        side = rng.choice(["left", "right"])
        lift, height = jumps([frames // 2], frames=frames) if rng.random() < 0.3 else (None, None)
        motion = person(
            frames, rng.uniform(0, 4) * (rng.random() < 0.7), rng.choice([0, np.pi, np.pi / 2, -np.pi / 2]), heading,
            height, rng.uniform(0, 0.5),
            lift, raised(frames, 10, side, rng.uniform(0, 0.7), rng.choice([0, 0.12])), kick(frames, 15,
            side) if rng.random() < 0.3 else None,
        )  # fmt: skip
        told += mirrored_pairs(motion)
    assert told > 25


def test_real_motions_and_their_mirror_images():
    folder = Path(os.environ.get("BUNRAKU_MOTIONS", "runs/data/motions"))
    if not (folder / "index.json").is_file():
        pytest.skip("the motions are not built; name their folder with BUNRAKU_MOTIONS")
    index = load_index(folder)
    names = [name for name, entry in sorted(index.items()) if not entry.get("species")]
    for name in names[:: len(names) // 40]:
        mirrored_pairs(load_clip(folder / f"{name}.npz"))


def test_real_kicks_walks_and_runs_say_what_their_labels_say():
    folder = Path(os.environ.get("BUNRAKU_MOTIONS", "runs/data/motions"))
    if not (folder / "index.json").is_file():
        pytest.skip("the motions are not built; name their folder with BUNRAKU_MOTIONS")
    index = load_index(folder)
    wanted = {
        "a person kicks forward with the left leg": ("left", "right foot"),
        "run/jog": ("run", "walk"),
        "a person walks forward": ("walk", "run"),
    }
    for label, (right, wrong) in wanted.items():
        told = []
        for name, entry in index.items():
            if (
                label in [text.lower() for text in entry["texts"]]
                and entry.get("source", "").find("character archive") < 0
            ):
                told.append(" ".join(sentences(describe(load_clip(folder / f"{name}.npz")), 0, 10**6)))
        assert (
            told and np.mean([right in one for one in told]) > 0.7 and np.mean([wrong in one for one in told]) < 0.06
        ), label


def test_runs_and_chains():
    assert runs(np.array([0, 1, 1, 0, 1, 0, 0, 1], bool), 2, 1) == [(1, 5)]
    assert runs(np.zeros(4, bool)) == [] and runs(np.ones(3, bool)) == [(0, 3)]
    assert [chain(["a", "b", "c"], variant) for variant in range(3)] == [
        "a, then b, then c",
        "a, b and then c",
        "a, b, and then c",
    ]
    assert chain(["a"]) == "a" and chain([]) == ""
    far, near = (
        Phrase("turn", ("{turn} left",), 0, 20),
        Phrase("go", ("{walk} forward",), 5, 60, ("{walk} forward",), ("forward",)),
    )
    (kept,) = inside([far, near], 10, 50)
    assert (kept.start, kept.stop, kept.texts) == (0, 40, near.texts)
    assert conjugate("{raise} both hands and {wave}", "gerund") == "raising both hands and waving"


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_punch_is_of_the_hand_that_shoots_forward(side):
    """A fist before the chest that goes half a metre forward in 0.2 s and back, and one that goes up instead."""
    sign = 1 if side == "left" else -1
    out = np.interp(np.arange(40), [15, 19, 25], [0, 1, 0])
    offsets = np.zeros((40, 3))
    offsets[:, 0], offsets[:, 1], offsets[:, 2] = -0.5 * sign, 0.0, 0.1 + 0.5 * out
    found = find_punches(Track.of(person(40, hands={side: offsets})))
    assert [phrase.texts[0] for phrase in found] == [f"{{punch}} with the {side} hand"]
    assert found[0].start < 15 and found[0].stop > 19
    offsets[:, 1], offsets[:, 2] = 0.5 * out, 0.1
    assert not find_punches(Track.of(person(40, hands={side: offsets})))


def test_sitting_down_and_standing_up_again():
    """Down to 40 cm in a second, two seconds on the chair, and up; a squat that comes up at once is none."""
    height = -np.interp(np.arange(120), [20, 40, 80, 100], [0, 0.4, 0.4, 0])
    sits, rises = find_seats(Track.of(person(120, height=height)))
    assert (
        sits.texts[:2] == ("{sit} down", "{sit} down on a chair") and 20 <= sits.start <= 30 and 40 <= sits.stop <= 70
    )
    assert rises.texts[0] == "{stand} up from the chair" and 60 <= rises.start <= 90 and rises.stop >= 95
    squat = -np.interp(np.arange(60), [20, 28, 36], [0, 0.4, 0])
    assert not find_seats(Track.of(person(60, height=squat)))
    low = -np.interp(np.arange(120), [20, 40], [0, 0.7])
    assert find_seats(Track.of(person(120, height=low)))[0].texts[1] == "{sit} down on the floor"
