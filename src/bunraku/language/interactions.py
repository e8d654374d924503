"""What a clause says the body does with a thing: hands touch it, it is taken and put somewhere, feet walk on it, eyes
look at it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bunraku.language.lexicon import actions_of, lexicon, said_phrases, words_of
from bunraku.language.phrasing import (
    body_stems,
    does_else,
    named_hands,
    names_a_thing,
    object_of,
    verbs_in,
    way_in,
    zone_of,
)
from bunraku.language.things import Gaze, Kind, Named, named_in, things
from bunraku.language.things import things as known_things
from bunraku.language.vocabulary import action_stems, stem

__all__ = [
    "Contact",
    "Handling",
    "HandlingStep",
    "Interaction",
    "Place",
    "Terrain",
    "contact_of",
    "contact_words",
    "gaze_of",
    "gaze_words",
    "handling_of",
    "interaction_of",
    "says_more",
    "terrain_of",
    "terrain_words",
    "thing_words",
    "with_names",
]


_THROUGH = "see through"
_GIVEN = frozenset(("portable",))
_NEAR = 4
"""Words after an animal among which its part is."""


class Contact(NamedTuple):
    """What hands do with a thing.

    Args:
        deed: Of `[deeds]` in `things.toml`.
        hands: "both", "left", "right", or "one" for either.
        height: Where palms meet it, for a body of 1.84 m [m]; 0 where the deed itself says it.
        surface: Which way it faces there: "top", "front" or "grip".
        way: "left" or "right"; "" for straight ahead.
    """

    deed: str
    hands: str
    height: float = 0.0
    surface: str = "front"
    way: str = ""


@functools.lru_cache(maxsize=1024)
def contact_of(text: str) -> Contact | None:
    """What a clause says that hands do with a thing; None where it says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    words = words_of(text)[0]
    rows, said = lexicon().actions, said_phrases(text)["actions"]
    starts = {start for action, start in said.items() if not rows[action].passing}
    for verb, zone, deed, thing in _contacts_in(words):
        known = thing is None or thing.means is not things().unknown
        if not does_else(text, verb, zone) and (known or verb not in starts):
            return _made(words, zone, deed, thing)
    return None


def contact_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is done with things."""
    found: set[int] = set()
    for verb, _, _, thing in _contacts_in(words_of(text)[0]):
        known = thing is not None and thing.means is not things().unknown
        found.update((verb, *(range(thing.start, thing.stop) if thing and known else ())))
    return frozenset(found)


def _contacts_in(words: Sequence[str]) -> list[tuple[int, range, str, Named[Kind] | None]]:
    """Each verb of a text whose deed is known: its number, what belongs to it, the deed, and the thing."""
    table = things()
    found: list[tuple[int, range, str, Named[Kind] | None]] = []
    for verb, said in verbs_in(words, table.verbs | dict.fromkeys(table.looks, _THROUGH)):
        zone = zone_of(words, verb)
        what, goes = _meant(words, said, zone)
        thing = _thing_touched(words, goes, what) if what else None
        if thing is not None:
            found.append((verb, zone, thing.means.deeds[what], thing))
        elif what == "hold out" or (
            what in table.defaults and not lexicon().grammar["hands"].intersection(words[zone.start : zone.stop])
        ):
            found.append((verb, zone, table.defaults[what], None))
    return found


def _meant(words: Sequence[str], what: str, zone: range) -> tuple[str, range]:
    """What a verb says is done, "" for nothing, and the words among which its thing is."""
    own, grammar = words[zone.start : zone.stop], lexicon().grammar
    hand = next((at for at in zone if words[at] in grammar["hands"]), -1)
    if what == _THROUGH:
        return (what if grammar["seen through"].intersection(own) else ""), zone
    if what in ("give", "hold", "reach out") and _alone(words, hand, zone) and (what == "give" or "out" in own):
        return "hold out", range(0)
    if what == "hold" and "out" in own:
        return "give", zone
    if what in ("lay", "press") and hand >= 0 and grammar["laid"].intersection(words[hand : zone.stop]):
        return "lay", range(hand + 1, zone.stop)
    if what == "lay" or (what == "lean" and not grammar["laid"].intersection(own)):
        return "", zone
    return what, zone


def _alone(words: Sequence[str], hand: int, zone: range) -> bool:
    """Whether a hand is what somebody holds out, and no "hand signals"."""
    near = object_of(words, zone)
    return hand == near.stop - 1 and len(near) < _NEAR


def _thing_touched(words: Sequence[str], zone: range, what: str) -> Named[Kind] | None:
    """The last of what the verb has first, "a car window", that this is done with, or what that is of or on, "the neck
    of a camel"; of who drinks anything after it; of what is not known the usual.
    """
    table, near = things(), object_of(words, zone)
    known = _done_with(words, near, what)
    if known:
        return known[-1]
    joint = words[near.stop] if near.stop < zone.stop else ""
    if joint in ("of", "on", "into"):
        of = _done_with(words, object_of(words, range(near.stop + 1, zone.stop)), what)
        known = [one for one in of if joint == "into" or not _GIVEN & one.means.kinds]
    elif what in table.defaults or what == _THROUGH:
        known = _done_with(words, zone, what)
    if known:
        return known[0]
    named = named_in(table.kinds, words, near.start, near.stop)
    if named or what not in table.unknown.deeds or not names_a_thing(words, near):
        return None
    return Named(near.start, near.stop, table.unknown)


def _done_with(words: Sequence[str], some: range, what: str) -> list[Named[Kind]]:
    """The things among some words that something is done with."""
    known = [one for one in named_in(things().kinds, words, some.start, some.stop) if what in one.means.deeds]
    return [one for one in known if _GIVEN & one.means.kinds] if what == "give" else known


def _made(words: Sequence[str], zone: range, deed: str, thing: Named[Kind] | None) -> Contact:
    hands, way = named_hands(words), way_in(words, zone)
    if not hands and "hands" in words[zone.start : zone.stop]:
        hands = "both"
    if thing is None:
        return Contact(deed, hands or "one", way=way)
    kind = thing.means
    about = range(max(thing.start - _NEAR, zone.start), min(thing.stop + _NEAR, zone.stop))
    part = things().parts.intersection(words[about.start : about.stop])
    height = kind.head if part and kind.head else kind.height
    return Contact(deed, hands or kind.hands or "one", height, kind.surface, way)


class Terrain(NamedTuple):
    """How somebody walks.

    Args:
        ground: Of `[grounds]` in `things.toml`.
        height: Where both palms are that push or pull something [m]; 0 for arms that do nothing of the kind.
    """

    ground: str
    height: float = 0.0


@functools.lru_cache(maxsize=1024)
def terrain_of(text: str) -> Terrain | None:
    """What a clause says that somebody walks on, in, or with; None where it says nothing of that, or something else
    beside it.

    Args:
        text: In English.
    """
    words, starts = words_of(text)[0], said_phrases(text)["actions"]
    for verb, zone, footing, own in _terrain_in(words):
        way = "way" in words[zone.start : own.start]  # "fights his way through"
        others = [action for action in actions_of(text) if action not in things().actions["walk"]]
        if all(zone.start < starts[one] < own.stop or (way and starts[one] == verb) for one in others):
            return footing
    return None


def terrain_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is walked on, in, or with."""
    words, found = words_of(text)[0], set[int]()
    for verb, zone, _, own in _terrain_in(words):
        named = named_in(things().grounds, words, zone.start, zone.stop)
        found.update((verb, *own, *(at for one in named for at in range(one.start, one.stop))))
    return frozenset(found)


def _terrain_in(words: Sequence[str]) -> list[tuple[int, range, Terrain, range]]:
    """Each verb of walking, with what belongs to it, how that makes somebody walk, and the words that say it."""
    table, found = things(), []
    for verb, implied in verbs_in(words, table.walks):
        zone = zone_of(words, verb)
        for start, stop, meant in named_in(table.grounds, words, zone.start, zone.stop):
            said = lexicon().grammar["ends"].intersection(words[zone.start : start]) or {implied}
            own = next((one for one in meant if said & one.after), None)
            if own is not None:
                found.append((verb, zone, Terrain(own.name), range(start, stop)))
                break
        else:
            if words[verb] in table.treads:
                found.append((verb, zone, Terrain(table.treads[words[verb]]), range(zone.start, zone.start)))
    for verb, what in verbs_in(words, table.verbs):
        zone = zone_of(words, verb)
        near = object_of(words, zone)
        for start, stop, kind in reversed(named_in(table.kinds, words, near.start, near.stop)):
            if what in kind.going:
                found.append((verb, zone, Terrain(kind.going[what], kind.height), range(start, stop)))
                break
    return found


EYES, AWAY = 1.7, 1.6
"""How high eyes are, and how far away somebody stands who looks at a thing that hands meet [m]."""


@functools.lru_cache(maxsize=1024)
def gaze_of(text: str) -> Gaze | None:
    """Where a clause says that somebody looks; None where it says nothing of that, or something else beside it. What is
    not known is straight ahead.

    Args:
        text: In English.
    """
    words = words_of(text)[0]
    starts = said_phrases(text)["actions"]
    for verb, zone, seen in _gazes_in(words):
        shown = [action for action in actions_of(text) if starts[action] == verb]  # "looks around", a gesture
        if things().actions["look"].issuperset(shown) and not does_else(text, verb, zone):
            return seen.means
    return None


def gaze_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is looked at."""
    words, found = words_of(text)[0], set[int]()
    for verb, zone, seen in _gazes_in(words):
        some = [(one.start, one.stop) for one in named_in(things().sights, words, zone.start, zone.stop)]
        some += [(seen.start, seen.stop)] if seen.means != things().level else []
        found.update((verb, *(at for ends in some for at in range(*ends))))
    return frozenset(found)


def _gazes_in(words: Sequence[str]) -> list[tuple[int, range, Named[Gaze]]]:
    """Each verb of looking with what belongs to it and what is seen: what is named after it or, where nothing is,
    before it where somebody stands, "at a cliff and looks down"; of a thing that hands meet, how high it is.
    """
    table, found = things(), []
    for verb, _ in verbs_in(words, dict.fromkeys(table.looks, "")):
        zone = zone_of(words, verb)
        ways = [way for word in words[zone.start : zone.stop] for way in table.ways.get(word, ())]
        named = [
            Named(start, stop, next((sight for way in ways for name, sight in meant if name == way), meant[0][1]))
            for start, stop, meant in named_in(table.sights, words, zone.start, zone.stop)
        ]
        if not named:
            before = named_in(table.sights, words, 0, verb)
            named = [
                Named(start, stop, sight) for start, stop, meant in before for name, sight in meant if name in ways
            ]
        near = object_of(words, zone)
        if not named and (table.looks[words[verb]] or "at" in ways):
            known = named_in(table.kinds, words, near.start, near.stop)
            if known:
                down = math.degrees(math.atan2(EYES - known[-1].means.height, AWAY))
                named = [Named(known[-1].start, known[-1].stop, Gaze(down))]
            elif names_a_thing(words, near):
                named = [Named(near.start, near.start, table.level)]
        if named and words[zone.start] not in lexicon().grammar["sought"]:
            found.append((verb, zone, named[0]))
    return found


_HANDLED = frozenset(("handle", "pick up", "put down", "carry", "reach"))
"""Actions that say no more than that a thing is handled."""
_WORN = frozenset(("on", "off"))
"""After a verb, without a thing: something that is worn."""
_PUT = frozenset(("floor", "low", "table", "high"))
"""Heights at which something is put down by who carries it there."""
_MOST = 6
"""Words of a thing's name at the most, its determiner included."""


class Place(NamedTuple):
    """Where a thing is.

    Args:
        height: Of the lexicon's `levels`; "" where nothing is said of it.
        way: "left", "right", "aside" for either of them; "" for straight ahead.
    """

    height: str = ""
    way: str = ""

    def __bool__(self) -> bool:
        return bool(self.height or self.way)


class HandlingStep(NamedTuple):
    """One thing that is done with what is handled.

    Args:
        does: "take", "hold" or "put".
        place: Where.
    """

    does: str
    place: Place


@dataclass(frozen=True)
class Handling:
    """What is done with a thing.

    Args:
        stations: One after the other; all heights are said.
        hands: "both", "left", "right", or "one" for either.
        said: More is said than that something is taken from the floor, put down or carried, as people were captured.
        repeated: It is done again and again.
    """

    stations: tuple[HandlingStep, ...]
    hands: str
    said: bool = False
    repeated: bool = False

    @property
    def only_held(self) -> bool:
        """Whether a thing is held all the time."""
        return all(one.does == "hold" for one in self.stations)


@functools.lru_cache(maxsize=1024)
def handling_of(text: str) -> Handling | None:
    """What a clause says is done with a thing; None where it says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    if not set(actions_of(text)) <= _HANDLED:
        return None
    words = words_of(text)[0]
    starts = [at for at in range(len(words)) if _verb(words, at)]
    segments = [_Segment.of(words, at, stop) for at, stop in zip(starts, [*starts[1:], len(words)], strict=False)]
    found: list[HandlingStep] = []
    things: list[str] = []
    for segment in segments:
        if segment.thing is None and not (found and (segment.source or segment.goal)):
            continue
        found += segment.stations(found)
        things.append(segment.thing or "")
    if not found:
        return None
    kinds = [kind for thing in things for kind in _kinds(thing)]
    small = any(_level(kind.height) == "table" for kind in kinds)
    hands = named_hands(words)
    stations = _whole(found, small)
    held = all(one.does == "hold" for one in found)
    said = (
        (bool(hands) and not (held and hands == "both"))
        or {"take", "put"} <= {one.does for one in found}
        or any(map(_tells, found))
        or any(one.does == "take" and small for one in found)
    )
    if not hands:
        far = any(one.place.height in ("overhead", "floor") for one in stations)
        taken = {kind.hands for kind in kinds}
        hands = "both" if "both" in taken or (far and taken <= {""}) else "one"
    return Handling(tuple(stations), hands, said, "weights" in words or "weightlifting" in words)


class _Segment(NamedTuple):
    """What is said of one verb: its kind, its thing (None for none), from where, to where, and where at all."""

    kind: str
    thing: str | None
    source: Place
    goal: Place
    at: Place
    down: bool
    back: bool
    up: bool

    @classmethod
    def of(cls, words: Sequence[str], at: int, stop: int) -> _Segment:
        kind = _verb(words, at)
        thing, after = _thing_held(words, at + 1, stop, kind)
        grammar = lexicon().grammar
        places = {"from": Place(), "to": Place(), "at": Place()}
        mode = "at"
        own = words[at + 1 : stop]
        for number in range(after, stop):
            word = words[number]
            if word in grammar["from"]:
                mode = "from"
            elif word in grammar["to"]:
                mode = "to"
            elif word in ("with", "using", "and", ",", "in", "at", "of") and mode == "to" and places["to"]:
                mode = "at"
            places[mode] = _added(places[mode], _place(words, number))
        return cls(kind, thing, places["from"], places["to"], places["at"], "down" in own, "back" in own, "up" in own)

    def stations(self, before: Sequence[HandlingStep]) -> list[HandlingStep]:
        """What this verb adds to what was done before."""
        held = bool(before) and before[-1].does != "put"
        away = [HandlingStep("take", self.source)] if self.source or not held else []
        goal = self.goal or self.at
        if self.kind == "take":
            source = self.source or self.at
            if not (source.height or self.up or any(kind.hands == "both" for kind in _kinds(self.thing or ""))):
                source = Place("table", source.way)
            return [HandlingStep("take", source), HandlingStep("hold", self.goal)]
        if self.kind in ("lift", "raise"):
            own = Place("chest" if self.kind == "lift" else "high")
            there = goal if goal.height else _added(goal, own)
            return [*away, HandlingStep("hold", there)]
        if self.kind == "hold" or (self.kind == "carry" and not (self.source or goal.way or goal.height in _PUT)):
            return [HandlingStep("hold", goal)]
        if self.kind == "put":
            goal = _added(self.goal, self.at)
            taken = next((one.place for one in before if one.does == "take"), Place())
            if self.back and taken:
                goal = goal or taken
            elif self.down and not goal.height:
                goal = Place("down", goal.way)
            start = (
                [HandlingStep("take", self.source)] if self.source else [] if held else [HandlingStep("hold", Place())]
            )
            return [*start, HandlingStep("put", goal)]
        return [*away, HandlingStep("put", goal)]


def _verb(words: Sequence[str], at: int) -> str:
    """The kind of handling that a verb says; "" for none."""
    grammar = lexicon().grammar
    named = at > 0 and (words[at - 1] in grammar["determiners"] or words[at - 1] in grammar["before names"])
    return "" if named else lexicon().handling_verbs.get(words[at], "")


def _kinds(thing: str) -> list[Kind]:
    """The kinds of things that are carried among some words."""
    words = thing.split()
    return [one.means for one in named_in(known_things().kinds, words, 0, len(words)) if "portable" in one.means.kinds]


def _level(height: float) -> str:
    """The level that is nearest to a height [m]."""
    levels = lexicon().levels
    return min(levels, key=lambda name: abs(levels[name] - height))


def _thing_held(words: Sequence[str], at: int, stop: int, kind: str) -> tuple[str | None, int]:
    """The words for what is handled, None where no thing is named, and the number of the word after them."""
    grammar = lexicon().grammar
    while at < stop and (words[at] in grammar["particles"] or words[at].endswith("ly")):
        at += 1
    if at < stop and words[at] in grammar["pronouns"]:
        return words[at], at + 1
    last = at
    while last < min(stop, at + _MOST) and words[last] not in grammar["ends"] and words[last].isalnum():
        last += 1
    named = words[at:last]
    listed = bool(_kinds(" ".join(named)))
    if not named or not (named[0] in grammar["determiners"] or listed):
        return None, at
    if any(stem(word) in body_stems() for word in named) or (last < stop and words[last] in _WORN and last == stop - 1):
        return None, at
    unsure = stem(named[-1]) in action_stems() or len(named) < 2 or kind in ("hold", "raise", "move")
    return (None, at) if unsure and not listed else (" ".join(named), last)


def _place(words: Sequence[str], at: int) -> Place:
    """The place that a word says among others."""
    word = words[at]
    after = words[at + 1] if at + 1 < len(words) else ""
    before = words[at - 1] if at else ""
    if word in ("left", "right"):
        of_hand = after in lexicon().grammar["limbs"] or (after == "side" and before == "with")
        return Place() if of_hand else Place("", word)
    for height, said in lexicon().heights.items():
        if word in said:
            near = words[max(at - 4, 0) : at]
            if height == "overhead" and word == "head" and not {"over", "above", "on"} & set(near):
                continue
            return Place(height)
    kind = known_things().kinds.get(word)
    if kind is not None and kind.place:
        return Place(_level(kind.height))
    return Place("", "aside") if word in lexicon().aside else Place()


def _added(place: Place, other: Place) -> Place:
    return Place(place.height or other.height, place.way or other.way)


def _tells(station: HandlingStep) -> bool:
    """Whether a station says more than that a thing is taken from the floor, or put down there."""
    height, way = station.place
    return bool(way) or (station.does == "hold" and bool(height) and height != "chest") or height not in (
        "", "floor", "down", "chest",
    )  # fmt: skip


def _whole(stations: Sequence[HandlingStep], small: bool) -> list[HandlingStep]:
    """Stations whose heights are all said: a cup stands on a table, and what is moved aside stays as high as it was."""
    moved = any(one.place.way for one in stations)
    start = "table" if small or moved else "floor"
    found: list[HandlingStep] = []
    for one in stations:
        height, way = one.place
        if one.does == "take":
            height = height or start
        elif one.does == "hold":
            height = height or "chest"
        elif height in ("", "down"):
            taken = next((before.place.height for before in reversed(found) if before.does == "take"), "")
            height = taken or ("floor" if height == "down" and not small else "table")
        found.append(HandlingStep(one.does, Place(height, way)))
    return found


Interaction = Handling | Contact | Terrain | Gaze


def interaction_of(text: str) -> Interaction | None:
    """What a clause says that is done with a thing, or what follows from where somebody walks or looks; None where it
    says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    return terrain_of(text) or contact_of(text) or gaze_of(text) or handling_of(text)


def says_more(told: object) -> bool:
    """Whether it is one of the forms of `Told`, and more than what people were captured doing with things."""
    return isinstance(told, Interaction) and (not isinstance(told, Handling) or told.said)


def thing_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that are understood by what things are."""
    return terrain_words(text) | contact_words(text) | gaze_words(text)


def with_names(clauses: Sequence[str]) -> list[str]:
    """Clauses in a row with the thing that one has before in place of "it", where that is done something with: "walks
    to the window", "opens the window".
    """
    found: list[str] = []
    last = ""
    for text in clauses:
        words, spans = words_of(text)
        for verb, _ in verbs_in(words, things().verbs):
            near = object_of(words, zone_of(words, verb))
            own = words[near.start : near.stop]
            if last and (own in (["it"], ["them"]) or own[:1] == ["its"]):
                start, stop = spans[near.start]
                of = "'s" if own[0] == "its" else ""
                named = f"{text[:start]}the {last}{of}{text[stop:]}"
                text = named if contact_of(named) else text
                break
        found.append(text)
        nouns = named_in(things().kinds, words, 0, len(words))
        last = " ".join(words[nouns[-1].start : nouns[-1].stop]) if nouns else last
    return found
