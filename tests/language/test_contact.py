"""What a sentence says that hands do with a thing, and how high that is for a body of 1.84 m."""

import pytest

from bunraku.language.contact import contact_of
from bunraku.language.parse import parse
from bunraku.language.understood import understood


@pytest.mark.parametrize(
    ("text", "deed", "lowest", "highest"),
    [
        ("pat a dog's head", "pat", 0.5, 0.85),  # a head at a knee or a hip
        ("a person strokes a kitten", "stroke", 0.1, 0.4),
        ("Pet the pony", "stroke", 0.9, 1.2),
        ("scratches a horse behind the ears", "scratch", 1.3, 1.6),
        ("Open the door", "swing open", 0.95, 1.15),
        ("a person slides the patio door open", "slide", 0.95, 1.15),
        ("pull out the drawer", "pull", 0.7, 1.0),
        ("closes the trunk of a car", "lower", 0.7, 1.1),
        ("push the elevator button", "press", 1.1, 1.4),
        ("Grab handle", "grip", 0.9, 1.2),
        ("cranks the handle of a well", "crank", 0.9, 1.2),
        ("wipes the blackboard", "wipe", 1.1, 1.6),
        ("scrubs the bathtub", "wipe", 0.4, 0.7),
        ("rests a hand on a tombstone", "touch", 0.6, 1.0),
        ("a person puts both hands on the desk", "touch", 0.8, 1.05),
        ("leans against a tree", "lean", 1.1, 1.6),
        ("pats a child on the head", "pat", 0.8, 1.3),
        ("strokes the neck of a camel", "stroke", 1.5, 2.0),
        ("presses a key on the control panel", "press", 1.0, 1.4),
        ("rests both hands on the gizmo", "touch", 0.8, 1.4),
        ("opens a can", "open held", 0.8, 1.3),
        ("pours water into a glass", "pour", 0.8, 1.3),
        ("waters the plants", "water", 0.4, 1.0),
        ("drives a truck", "drive", 0.5, 1.5),
        ("rows a boat", "row", 0.3, 1.5),
        ("puts a hand on somebody's shoulder", "touch", 1.2, 1.6),
        ("touches the contraption", "touch", 0.8, 1.4),  # which the table does not know
    ],
)
def test_what_is_done_and_how_high_follows_from_the_thing(text, deed, lowest, highest):
    found = contact_of(text)
    assert found.deed == deed and lowest < found.height < highest


@pytest.mark.parametrize(
    ("text", "deed", "hands"),
    [
        ("gives a woman a rose with the left hand", "offer", "left"),
        ("hands a letter to somebody", "offer", "one"),
        ("hands over the keys", "offer", "one"),
        ("holds out a hand to somebody", "offer", "one"),
        ("holds a lantern out in front of him", "offer", "one"),
        ("sips hot tea from a mug", "sip", "one"),
        ("drinks from a fountain", "drink bent", "one"),
        ("looks through binoculars", "hold at the eyes", "both"),
        ("turns a valve", "wheel", "both"),
        ("touches the wall with both hands", "touch", "both"),
        ("dodges a snowball", "dodge", "one"),
    ],
)
def test_hands_are_those_that_are_named_or_that_the_thing_takes(text, deed, hands):
    assert contact_of(text)[:2] == (deed, hands)


def test_a_thing_is_on_the_side_that_is_said():
    assert contact_of("presses the button on the left").way == "left"
    assert contact_of("presses the button with the left hand").way == ""


@pytest.mark.parametrize(
    "text",
    [
        "a person opens his arms",
        "turns to the left",
        "turns the page of a book",
        "hands on hips",
        "gives a speech",
        "gives basketball signals by hand",
        "holds a box",
        "washes hands in the sink",
        "brushes her hair",
        "cleans the floor with a mop",  # sweeps
        "walks and pats a dog",
        "a person shuffles as if drunk",
        "strokes with trunk rotation to the left",
        "rests on the bed",
        "looks at a telescope",
        "strokes his beard",
        "pats her head",
        "turns the contraption",
        "an open-hand strike",
    ],
)
def test_what_is_no_deed_at_a_thing_or_not_all_that_is_done_is_none(text):
    assert contact_of(text) is None


def test_it_is_what_was_named_before():
    first, second = parse("a person walks to the door, then opens it").clauses
    assert first.told is None and second.told.deed == "swing open"
    (clause,) = parse("walks over to the horse and strokes its mane").clauses
    assert [part.told and part.told.deed for part in clause.parts] == [None, "stroke"]
    (clause,) = parse("a person lifts a box and throws it").clauses
    assert clause.text.endswith("throws it")


def test_who_walks_and_sips_has_two_voices():
    (clause,) = parse("walks while sipping tea").clauses
    assert clause.body.text == "a person walks" and clause.meanwhile.told.deed == "sip"


def test_words_of_things_are_understood_where_something_is_done_with_them():
    found = understood("Pet the pony")
    assert found.ok and not found.unknown
    assert understood("touches a cactus").language == "en"  # "touches" is French, too
    assert [word.word for word in understood("a gecko dances").unknown] == ["gecko"]
