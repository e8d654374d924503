"""Which gestures the shipped pack offers: none that leaves out what a clause adds to its action.

The sentences are those for which a wrong gesture was once played without a word.
"""

import pytest

from bunraku.diffusion.examples.guidance_examples import GuidanceExamples
from bunraku.diffusion.generation.networks import Networks
from bunraku.diffusion.generation.texts import Texts
from bunraku.language.parse import clause_of, parse


@pytest.fixture(scope="module")
def networks():
    return Networks(None)


def known(networks, prompt):
    """What is found for a prompt, and its clauses."""
    clauses = parse(prompt, force=True).clauses
    texts = Texts.of(networks, [clauses], True, True, None)
    return GuidanceExamples(networks.examples, texts.shown), clauses


def offered(networks, prompt, seed=0):
    """The examples that a prompt starts from, and the counts that they are made with."""
    found, clauses = known(networks, prompt)
    example = found.of([(clause, 120) for clause in clauses], (seed, 0), 0)
    if example is None:
        return [], []
    return [networks.examples.examples[one.number] for one in example.found if one], [
        manner.count for manner in example.manners
    ]


@pytest.mark.parametrize(
    ("prompt", "lacking"),
    [
        ("scratch foot", ("foot",)),
        ("plays the guitar behind the back", ("back",)),
        ("claps above the head", ("head", "high")),
        ("punches twice with the right hand", ("2 times",)),
    ],
)
def test_a_gesture_that_leaves_out_what_is_added_is_not_used_and_it_is_said(networks, prompt, lacking):
    found, clauses = known(networks, prompt)
    assert not any(one.made for seed in range(4) for one in offered(networks, prompt, seed)[0])
    assert found.lacking(clauses[0]) == lacking


def test_who_sits_with_crossed_legs_is_no_gesture_of_sitting(networks):
    for seed in range(6):
        for one in offered(networks, "sits while crossing legs", seed)[0]:
            assert one.name.startswith("gesture_cross_legs")


@pytest.mark.parametrize(("seat", "texts"), [("ground", "on the floor"), ("chair", "on a chair")])
def test_legs_are_crossed_where_somebody_sits(networks, seat, texts):
    for seed in range(3):
        for one in offered(networks, f"sits on the {seat} and crosses his legs", seed)[0]:
            assert one.name.startswith("gesture_cross_legs") and texts in one.texts[1]


def test_a_thing_goes_through_its_places_or_is_picked_up_as_captured(networks):
    def of(prompt):
        found, clauses = known(networks, prompt)
        return [one.told for one in found._found[clauses[0].text]]

    assert [one.stations[-1].place for one in of("puts a box on a shelf to the left")] == [("high", "left")]
    assert of("a person picks up something from the floor")[0] is None


@pytest.mark.parametrize(
    ("prompt", "gesture", "part"),
    [
        ("scratch chin", "gesture_scratch", "chin"),
        ("touches the back of the head", "gesture_touch", "back-head"),
        ("pats his knee three times", "gesture_rub", "knee"),
        ("scratches the head", "gesture_scratch", ""),
        ("slaps", "gesture_slap", ""),
        ("duck quickly", "gesture_duck", ""),
        ("push door", "gesture_push", ""),
        ("looks up at the sky", "gesture_look_up", ""),
        ("balances on one leg", "gesture_balance", ""),
        ("a person does a sit-up, holding their head with both hands", "gesture_sit-up", ""),
        ("tie shoelaces", "gesture_tie_shoes", ""),
    ],
)
def test_a_gesture_is_done_where_the_sentence_says(networks, prompt, gesture, part):
    assert parse(prompt, force=True).corrected == ()
    found, clauses = known(networks, prompt)
    assert found.lacking(clauses[0]) == ()
    for seed in range(4):
        example = found.of([(clauses[0], 120)], (seed, 0), 0)
        (one,) = example.found
        assert networks.examples.examples[one.number].name.startswith(gesture) and one.part == part


def test_who_points_to_a_side_does_not_point_ahead(networks):
    for seed in range(8):
        (one,) = offered(networks, "points to the left", seed)[0]
        assert "points right" in one.texts  # in the mirror


@pytest.mark.parametrize(
    ("prompt", "gesture", "count"),
    [
        ("knock twice", "gesture_knock", 2),
        ("claps", "gesture_clap", None),
        ("a person claps three times", "gesture_clap", 3),
        ("nods 5 times", "gesture_nod", 5),
        ("the child waves goodbye", "gesture_wave", None),
    ],
)
def test_what_adds_nothing_is_a_gesture_with_its_count(networks, prompt, gesture, count):
    examples, counts = offered(networks, prompt)
    assert [one.name.rpartition("_")[0] for one in examples] == [gesture] and counts == [count]


def test_either_hand_waves_where_none_is_named_and_nobody_salutes_with_the_left(networks):
    def hands(prompt):
        found, clauses = known(networks, prompt)
        return {found.of([(clauses[0], 120)], (seed, 0), 0).found[0].mirrored for seed in range(24)}

    assert hands("waves") == {False, True}
    assert hands("waves with the left hand") == {True}
    assert hands("salutes") == {False}


def test_a_look_or_a_leg_is_on_the_side_that_is_said(networks):
    for prompt, gesture, mirrored in (
        ("look right", "gesture_look_aside", False), ("look left", "gesture_look_aside", True),
        ("stands on the right leg", "gesture_balance", False), ("stands on the left leg", "gesture_balance", True),
        ("eats with the right hand", "gesture_eat", False), ("eats with the left hand", "gesture_eat", True),
    ):  # fmt: skip
        found, clauses = known(networks, prompt)
        for seed in range(4):
            (one,) = found.of([(clauses[0], 120)], (seed, 0), 0).found
            assert networks.examples.examples[one.number].name.startswith(gesture) and one.mirrored == mirrored


def test_numbers_that_count_and_those_that_do_not():
    counts = {
        "claps twice": 2, "waves three times": 3, "does two jumping jacks": 2, "nods 4 times": 4, "bows once": 1,
        "waves with two hands": None, "walks with one hand on the hip": None, "claps": None,
    }  # fmt: skip
    assert {text: clause_of(text).count for text in counts} == counts


def test_what_a_clause_adds():
    added = {
        "scratches the chin": ("chin",), "sits while crossing legs": ("sits", "legs"), "claps happily": (),
        "waves at a friend": (), "a person applauds": (), "hugs somebody": (), "flexes both arms": (),
        "waves with the foot": ("foot",), "eats with the left hand": (), "does a spin": (),
        "does a sit-up, holding the head with both hands": ("head", "hands"),
        "does sit-ups holding a ball": ("holding",),
    }  # fmt: skip
    assert {text: clause_of(text).added for text in added} == added


def test_what_no_motion_shows_is_said(networks):
    def unseen(prompt):
        found, clauses = known(networks, prompt)
        return found.unseen(clauses[0])

    assert unseen("does the macarena") == ("macarena", "dance")
    for prompt in ("dances", "a person limps", "waves", "claps", "runs fast", "plays the guitar", "facepalms"):
        assert unseen(prompt) == ("", "")
