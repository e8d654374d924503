"""Trembling and wandering headings of motions whose numbers are known."""

import numpy as np
import pytest

from bunraku.diffusion.features import FEATURE_SIZE
from bunraku.diffusion.generation.finishing import STRENGTH, steadied, straightened, turned_as_asked
from bunraku.language.parse import clause_of

FPS = 20
TIME = np.arange(200) / FPS


def features(channel, values):
    out = np.zeros((len(values), FEATURE_SIZE), np.float32)
    out[:, channel] = values
    return out


@pytest.mark.parametrize(("hertz", "least", "most"), [(1, 0.99, 1.01), (2, 0.95, 1.01), (8, 0.0, 1 - 0.8 * STRENGTH)])
def test_slow_ways_stay_and_trembling_goes(hertz, least, most):
    wave = np.sin(2 * np.pi * hertz * TIME + 0.3)
    after = steadied(features(9, wave))[10:-10, 9]
    assert least <= after.std() / wave.std() <= most


def test_a_straight_line_and_the_way_over_the_ground_stay():
    ramp = features(9, 0.1 * TIME)
    np.testing.assert_allclose(steadied(ramp)[2:-2], ramp[2:-2], atol=1e-6)
    shaking = features(1, np.where(np.arange(200) % 2, 1.0, -1.0))
    np.testing.assert_array_equal(steadied(shaking), shaking)


def test_the_end_of_a_loop_is_steadied_with_its_start():
    random = np.random.default_rng(0).normal(size=60).astype(np.float32)
    once = steadied(features(9, random), loop=True)[:, 9]
    again = steadied(features(9, np.roll(random, 7)), loop=True)[:, 9]
    np.testing.assert_allclose(np.roll(once, 7), again, atol=1e-6)


def heading(values):
    return float(np.degrees(values[:, 0].sum() / FPS))


def test_forward_holds_its_course_and_keeps_its_sway():
    """A drift of 3 degrees a second goes, hips that turn to and fro with each stride stay."""
    sway = 0.5 * np.sin(2 * np.pi * 1.2 * TIME)
    drifting = features(0, np.radians(3.0) + sway)
    after = straightened(drifting, [(clause_of("a person walks forward"), 200)], FPS)
    assert heading(drifting) > 25 and abs(heading(after)) < 6  # half a stride at each end
    assert np.corrcoef(after[20:-20, 0], sway[20:-20])[0, 1] > 0.99


def test_only_the_sentence_that_says_forward_is_straightened():
    turning = features(0, np.full(200, np.radians(9.0)))
    script = [(clause_of("a person walks in a circle"), 100), (clause_of("a person walks forward"), 100)]
    after = straightened(turning, script, FPS)
    assert heading(after[:100]) == pytest.approx(45, abs=0.5) and abs(heading(after[100:])) < 1


@pytest.mark.parametrize(
    ("sentence", "before", "after"),
    [
        ("a person turns around", 110, 155),
        ("a person turns around", -120, -155),
        ("a person turns around", 300, 205),
        ("a person turns left", 100, 100),
        ("a person turns left", 45, 60),
        ("a person turns left", -60, -60),  # the wrong way is not repaired here
        ("a person turns around", 60, 60),  # nor is less than two thirds
        ("a person walks", 60, 60),
    ],
)
def test_a_turn_that_nearly_goes_as_far_as_asked_does(sentence, before, after):
    turning = features(0, np.full(60, np.radians(before) / 3))
    assert heading(turned_as_asked(turning, [(clause_of(sentence), 60)], FPS)) == pytest.approx(after, abs=0.5)
