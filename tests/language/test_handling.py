"""What a sentence says of a thing that is handled: hands, and places one after the other."""

import pytest

from bunraku.language.handling import handling_of
from bunraku.language.parse import parse


def told(text):
    """Hands and stations as words: "take floor", "put table left"."""
    found = handling_of(text)
    return found and (found.hands, [" ".join((one.does, *one.place)).strip() for one in found.stations])


@pytest.mark.parametrize(
    ("text", "hands", "stations"),
    [
        ("a person takes a cup from the shelf with the left hand", "left", ["take high", "hold chest"]),
        ("a person moves a box from the left to the right", "both", ["take table left", "put table right"]),
        ("picks up a bottle and puts it on the floor", "one", ["take table", "hold chest", "put floor"]),
        ("lifts the crate above the head", "both", ["take floor", "hold overhead"]),
        ("a person puts something on a high shelf", "one", ["hold chest", "put high"]),
        ("picks up an object with two hands and puts it back", "both", ["take floor", "hold chest", "put floor"]),
        ("a person lowers the box to the ground", "both", ["hold chest", "put floor"]),
        ("a person takes a book from low on the right", "one", ["take low right", "hold chest"]),
        ("carries a suitcase over his head", "one", ["hold overhead"]),
    ],
)
def test_hands_and_places_are_read(text, hands, stations):
    assert told(text) == (hands, stations)


@pytest.mark.parametrize(
    "text",
    [
        "a person raises the left arm",
        "a person lifts the right leg",
        "takes a step to the left",
        "takes a bow",
        "a person puts on a hat",
        "moves to the left",
        "puts the hands on the hips",
        "a person picks up a ball and throws it",
        "a person walks and carries a box",
        "holds a plank",
        "waves",
    ],
)
def test_what_is_no_thing_or_not_all_that_is_done_is_not_handled(text):
    assert told(text) is None


def test_only_what_says_more_than_the_floor_is_more_than_picking_up():
    assert not handling_of("a person picks up a box from the floor").said
    assert not handling_of("a person carries a box").said
    for text in (
        "picks up a cup",
        "picks up a box with one hand",
        "picks up a box and puts it down",
        "takes a box from the shelf",
    ):
        assert handling_of(text).said


def test_a_thing_that_is_not_let_go_of_makes_one_clause():
    (one,) = parse("a person picks up a box, then places it on the shelf").clauses
    assert [station.does for station in one.told.stations] == ["take", "hold", "put"]
    assert one.seconds == pytest.approx(6)
    assert len(parse("a person puts a box down, then picks up a cup").clauses) == 2


def test_who_holds_something_over_the_head_on_the_way_has_two_voices():
    (clause,) = parse("a person holds a box over his head and walks").clauses
    assert clause.body.text == "a person walks" and clause.meanwhile.part == "arms"
    (carried,) = parse("a person walks while carrying a box").clauses  # as captured people do
    assert carried.meanwhile is None


def test_what_somebody_is_doing_beside_a_finite_verb_is_a_part_of_its_own():
    clauses = parse("the person walked forward and is picking up his toolbox").clauses
    assert [clause.text for clause in clauses] == ["The person walks forward", "The person picks up his toolbox"] or [
        part.text for part in clauses[0].parts
    ] == ["the person walks forward", "the person picks up his toolbox"]


def test_who_sits_down_and_crosses_the_legs_does_both_at_once():
    *_, last = parse("a man walks forward, sits on the ground and crosses his legs").clauses
    assert last.actions == ("cross legs",) and "floor" in last.traits
    assert len(parse("a person sits down, then lies down").clauses) == 2


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("Bend knees", "squat"),
        ("Open door", "open door"),
        ("ascends a staircase", "climb"),
        ("mops to and fro", "sweep"),
    ],
)
def test_commands_without_an_article_are_read(text, action):
    (clause,) = parse(text).clauses
    assert clause.actions == (action,)


def test_back_and_forth_is_no_second_voice():
    (clause,) = parse("a person works a mop back and forth with both hands").clauses
    assert clause.meanwhile is None
