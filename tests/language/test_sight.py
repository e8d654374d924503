"""Where a sentence says that somebody looks: up is negative, as a head's pitch."""

import pytest

from bunraku.language.parse import parse
from bunraku.language.sight import sight_of


def test_where_somebody_looks_follows_from_what_is_seen():
    for text in ("a child gazes at a skyscraper", "gazes at the stars"):
        assert sight_of(text).pitch < -20
    for text in ("a person gazes at the ocean", "watches the sunset", "looks into the distance"):
        seen = sight_of(text)
        assert abs(seen.pitch) < 5 and seen.sweep > 10 and not seen.lean
    for text in ("looks down into a canyon", "peers into a well", "stands at a precipice and looks down"):
        seen = sight_of(text)
        assert seen.pitch > 20 and seen.lean > 10
    assert sight_of("looks down at the feet").pitch > 20
    assert sight_of("gazes across the valley").pitch < 5 < 20 < sight_of("looks into the valley").pitch
    assert abs(sight_of("stares at a painting on the wall").pitch) < 5


def test_what_hands_meet_is_as_low_as_that_and_what_is_not_known_is_straight_ahead():
    pitches = [sight_of(f"looks at the {thing}").pitch for thing in ("statue", "vase", "box")]
    assert pitches == sorted(pitches) and pitches[0] < 20 < 40 < pitches[2]
    assert abs(sight_of("looks at the contraption").pitch) < 5


@pytest.mark.parametrize(
    "text",
    [
        "looks at his watch",
        "looks around the room",
        "looks over his shoulder",
        "looks for a house",
        "shades his eyes and looks at the sea",
        "walks and looks at the sea",
        "looks to the left",
        "looks up at the sky",
        "looks tired",
        "looks at his hands",
    ],
)
def test_gestures_of_looking_and_what_is_done_beside_it_are_none(text):
    assert sight_of(text) is None


def test_what_limbs_do_beside_a_ground_is_a_voice_of_its_own_and_a_look_down_at_a_cliff_is_none():
    (clause,) = parse("stands at a precipice and looks down").clauses
    assert clause.told.lean > 10 and not clause.voices
    (clause,) = parse("walks through the snow with the arms raised").clauses
    assert clause.body.told.ground == "deep" and clause.meanwhile.text == "the arms raised"
