"""What a sentence says of contact, terrain, objects and gaze."""

from __future__ import annotations

import pytest

from bunraku.language.interactions import Handling, interaction_of, read_as
from bunraku.language.parse import parse
from bunraku.language.reader import load_reader
from bunraku.language.understood import understood

SAID = """
pat a dog's head | deed pat | 0.5 | 0.85
a person strokes a kitten | deed stroke | 0.1 | 0.4
Pet the pony | deed stroke | 0.9 | 1.2
scratches a horse behind the ears | deed scratch | 1.3 | 1.6
Open the door | deed swing open | 0.95 | 1.15
a person slides the patio door open | deed slide | 0.95 | 1.15
pull out the drawer | deed pull | 0.7 | 1.0
closes the trunk of a car | deed lower | 0.7 | 1.1
push the elevator button | deed press | 1.1 | 1.4
Grab handle | deed grip | 0.9 | 1.2
cranks the handle of a well | deed crank | 0.9 | 1.2
wipes the blackboard | deed wipe | 1.1 | 1.6
scrubs the bathtub | deed wipe | 0.4 | 0.7
rests a hand on a tombstone | deed touch | 0.6 | 1.0
a person puts both hands on the desk | deed touch | 0.8 | 1.05
leans against a tree | deed lean | 1.1 | 1.6
pats a child on the head | deed pat | 0.8 | 1.3
strokes the neck of a camel | deed stroke | 1.5 | 2.0
presses a key on the control panel | deed press | 1.0 | 1.4
rests both hands on the gizmo | deed touch | 0.8 | 1.4
opens a can | deed open held | 0.8 | 1.3
pours water into a glass | deed pour | 0.8 | 1.3
waters the plants | deed water | 0.4 | 1.0
drives a truck | deed drive | 0.5 | 1.5
rows a boat | deed row | 0.3 | 1.5
puts a hand on somebody's shoulder | deed touch | 1.2 | 1.6
touches the contraption | deed touch | 0.8 | 1.4
gives a woman a rose with the left hand | deed offer | 0 | 9
hands a letter to somebody | deed offer | 0 | 9
hands over the keys | deed offer | 0 | 9
holds out a hand to somebody | deed offer | 0 | 9
holds a lantern out in front of him | deed offer | 0 | 9
sips hot tea from a mug | deed sip | 0 | 9
drinks from a fountain | deed drink bent | 0 | 9
looks through binoculars | deed hold at the eyes | 0 | 9
turns a valve | deed wheel | 0 | 9
touches the wall with both hands | deed touch | 0 | 9
dodges a snowball | deed dodge | 0 | 9
a person walks through knee-deep snow | ground deep | 0 | 9
wades through a river | ground deep | 0 | 9
walks on a slackline | ground narrow | 0 | 9
tightrope walker crossing a wire | ground narrow | 0 | 9
walks along a narrow ledge | ground narrow | 0 | 9
a person walks across a frozen lake | ground slippery | 0 | 9
crosses the ice | ground slippery | 0 | 9
walks over hot coals | ground hot | 0 | 9
steps carefully over broken glass | ground sharp | 0 | 9
trudges through sand dunes | ground soft | 0 | 9
walks along the beach | ground soft | 0 | 9
steps over a log | ground obstacle | 0 | 9
steps over a puddle | ground obstacle | 0 | 9
walks the plank | ground narrow | 0 | 9
wades along the street | ground deep | 0 | 9
gropes along a corridor | ground dark | 0 | 9
mows the lawn | ground pushed | 0 | 9
shuffles over black ice | ground slippery | 0 | 9
steps over a sleeping dog | ground obstacle | 0 | 9
fights his way through a blizzard | ground windy | 0 | 9
walks up a steep hill | ground uphill | 0 | 9
climbs a hill | ground uphill | 0 | 9
walks down a hill | ground downhill | 0 | 9
a person walks uphill | ground uphill | 0 | 9
walks in the dark | ground dark | 0 | 9
walks against the wind | ground windy | 0 | 9
a man pushes a shopping cart | ground pushed | 0 | 9
pulls a sled through the snow | ground dragged | 0 | 9
walks while pushing a stroller | ground pushed | 0 | 9
a person takes a cup from the shelf with the left hand | take | 1.55 | 2.05
a person moves a box from the left to the right | put | 0.71 | 1.21
picks up a bottle and puts it on the floor | put | -0.05 | 0.45
lifts the crate above the head | hold | 1.81 | 2.31
a person puts something on a high shelf | put | 1.55 | 2.05
picks up an object with two hands and puts it back | put | -0.05 | 0.45
a person lowers the box to the ground | put | -0.05 | 0.45
a person takes a book from low on the right | take | 0.25 | 0.75
carries a suitcase over his head | hold | 1.81 | 2.31
a child gazes at a skyscraper | sight up | 0 | 9
gazes at the stars | sight up | 0 | 9
a person gazes at the ocean | sight far | 0 | 9
watches the sunset | sight far | 0 | 9
looks into the distance | sight far | 0 | 9
looks down into a canyon | sight deep | 0 | 9
peers into a well | sight deep | 0 | 9
looks down at the feet | sight down | 0 | 9
looks under the bed | sight under | 0 | 9
stares at a painting on the wall | sight level | 0 | 9
"""
"""Sentences, what is done in them, and between which heights [m], if that is asked."""
NOT_SAID = """
a person opens his arms
turns to the left
turns the page of a book
hands on hips
gives a speech
gives basketball signals by hand
washes hands in the sink
brushes her hair
cleans the floor with a mop
walks and pats a dog
a person shuffles as if drunk
strokes with trunk rotation to the left
rests on the bed
strokes his beard
pats her head
turns the contraption
an open-hand strike
a person raises the left arm
a person lifts the right leg
takes a step to the left
takes a bow
a person puts on a hat
moves to the left
puts the hands on the hips
a person picks up a ball and throws it
waves
looks at his watch
looks around the room
looks over his shoulder
looks for a house
shades his eyes and looks at the sea
walks and looks at the sea
looks to the left
looks up at the sky
looks tired
looks at his hands
jumps over a log
climbs a rope
runs through the snow
sneaks through the tall grass
crawls over the ice
a martial artist steps around into a deep stance
walks across the room
walks through the snow and waves
"""
"""Sentences in which nothing is done with a thing, or something else besides."""


def test_most_of_what_is_done_with_things_is_read_at_the_right_height() -> None:
    kinds, heights = [], []
    for kind, low, high, text in (
        (kind, float(low), float(high), text)
        for text, kind, low, high in (line.split(" | ") for line in SAID.strip().splitlines())
    ):
        found = {frame.action: float(frame.fields.get("height", 0)) for frame in load_reader().dealt(text)}
        kinds.append(kind in found and interaction_of(text) is not None)
        if kinds[-1] and high < 9:
            heights.append(low < found[kind] < high)
    assert sum(kinds) / len(kinds) > 0.8 and sum(heights) / len(heights) > 0.7


def test_nothing_is_done_with_things_where_nothing_of_the_kind_is_said() -> None:
    silent = [interaction_of(text) is None for text in NOT_SAID.strip().splitlines()]
    assert sum(silent) / len(silent) > 0.75


def test_it_is_what_was_named_before():
    first, second = parse("a person walks to the door, then opens it").clauses
    assert first.detail is None and second.detail.deed == "swing open"
    (clause,) = parse("walks over to the horse and strokes its mane").clauses
    assert [part.detail and part.detail.deed for part in clause.parts] == [None, "stroke"]
    (clause,) = parse("a person lifts a box and throws it").clauses
    assert clause.text.endswith("throws it")


def test_who_walks_and_sips_has_two_voices():
    (clause,) = parse("walks while sipping tea").clauses
    assert clause.body.text == "a person walks" and clause.meanwhile.detail.deed == "sip"


def test_who_waves_on_the_way_through_snow_does_both():
    (clause,) = parse("a person walks through the snow while waving").clauses
    assert clause.body.detail.ground == "deep" and clause.meanwhile.actions == ("wave",)


def test_a_thing_that_is_not_let_go_of_makes_one_clause():
    (one,) = parse("a person picks up a box, then places it on the shelf").clauses
    assert [station.does for station in one.detail.steps if station.does != "hold"] == ["take", "put"]
    assert one.seconds == pytest.approx(6)
    assert len(parse("a person puts a box down, then picks up a cup").clauses) == 2


def test_who_holds_something_over_the_head_on_the_way_has_two_voices():
    (clause,) = parse("a person holds a box above the head and walks").clauses
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


def test_words_of_things_are_understood_where_something_is_done_with_them():
    found = understood("Pet the pony")
    assert found.ok and not found.unknown


def test_only_what_says_more_than_the_floor_is_more_than_picking_up():
    assert not read_as(Handling, "a person picks up a box from the floor").said
    assert not read_as(Handling, "a person carries a box").said
    for text in (
        "picks up a cup",
        "picks up a cup with the left hand",
        "picks up a box and puts it down",
        "takes a box from the shelf",
    ):
        assert read_as(Handling, text).said


def test_what_limbs_do_beside_a_ground_is_a_voice_of_its_own_and_a_look_down_at_a_cliff_is_none():
    (clause,) = parse("stands at a precipice and looks down").clauses
    assert clause.detail.lean > 10 and not clause.voices
    (clause,) = parse("walks through the snow with the arms raised").clauses
    assert clause.body.detail.ground == "deep" and clause.meanwhile.text == "the arms raised"
