"""What a sentence says of the ground, or of what is pushed over it."""

import pytest

from bunraku.language.footing import footing_of
from bunraku.language.parse import parse


@pytest.mark.parametrize(
    ("text", "ground"),
    [
        ("a person walks through knee-deep snow", "deep"),
        ("wades through a river", "deep"),
        ("walks on a slackline", "narrow"),
        ("tightrope walker crossing a wire", "narrow"),
        ("walks along a narrow ledge", "narrow"),
        ("a person walks across a frozen lake", "slippery"),
        ("crosses the ice", "slippery"),
        ("walks over hot coals", "hot"),
        ("steps carefully over broken glass", "sharp"),
        ("trudges through sand dunes", "soft"),
        ("walks along the beach", "soft"),
        ("steps over a log", "obstacle"),
        ("steps over a puddle", "obstacle"),
        ("walks the plank", "narrow"),
        ("wades along the street", "deep"),
        ("gropes along a corridor", "dark"),
        ("mows the lawn", "pushed"),
        ("shuffles over black ice", "slippery"),
        ("steps over a sleeping dog", "obstacle"),
        ("fights his way through a blizzard", "windy"),
        ("walks up a steep hill", "uphill"),
        ("climbs a hill", "uphill"),
        ("walks down a hill", "downhill"),
        ("a person walks uphill", "uphill"),
        ("walks in the dark", "dark"),
        ("walks against the wind", "windy"),
        ("a man pushes a shopping cart", "pushed"),
        ("pulls a sled through the snow", "dragged"),
        ("walks while pushing a stroller", "pushed"),
    ],
)
def test_the_ground_is_read(text, ground):
    assert footing_of(text).ground == ground


@pytest.mark.parametrize(
    "text",
    [
        "walks along the river",
        "jumps over a log",
        "climbs a rope",
        "climbs a ladder",
        "runs through the snow",
        "sneaks through the tall grass",
        "crawls over the ice",
        "a martial artist steps around into a deep stance",
        "walks across the room",
        "pushes a button",
        "walks backwards through the snow",
        "walks through the snow and waves",
    ],
)
def test_other_ways_and_what_nobody_walks_on_are_none(text):
    assert footing_of(text) is None


def test_who_waves_on_the_way_through_snow_does_both():
    (clause,) = parse("a person walks through the snow while waving").clauses
    assert clause.body.told.ground == "deep" and clause.meanwhile.actions == ("wave",)
