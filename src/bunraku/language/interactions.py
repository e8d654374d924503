"""What a clause says that the body does with a thing: hands touch it or take it and put it somewhere, feet walk on it,
eyes look at it.

Each kind of interaction has a reader, which yields a `Reading` for each verb that says one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

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
from bunraku.language.vocabulary import action_stems, stem


class Contact(NamedTuple):
    """What hands do with a thing."""

    deed: str  # of `[deeds]` in `things.toml`
    hands: str  # "both", "left", "right", or "one" for either
    height: float = 0.0  # where palms meet the thing, for a body of 1.84 m [m]; 0 where the deed itself says it
    surface: str = "front"  # which way the thing faces there: "top", "front" or "grip"
    way: str = ""  # "left" or "right"; "" for straight ahead


class Terrain(NamedTuple):
    """What is walked on, in, or with."""

    ground: str  # of `[grounds]` in `things.toml`
    height: float = 0.0  # where both palms are that push or pull something [m]; 0 for arms that do nothing of the kind


class Place(NamedTuple):
    """Where a thing is."""

    height: str = ""  # of the lexicon's `levels`; "" where nothing is said of it
    way: str = ""  # "left", "right", "aside" for either of them; "" for straight ahead

    def __bool__(self) -> bool:
        return bool(self.height or self.way)

    def or_else(self, other: Place) -> Place:
        """This place with the height and the side of another one where it has none."""
        return Place(self.height or other.height, self.way or other.way)


class HandlingStep(NamedTuple):
    """One thing that is done with what is handled."""

    does: str  # "take", "hold" or "put"
    place: Place  # where


@dataclass(frozen=True)
class Handling:
    """What is taken, held and put somewhere."""

    steps: tuple[HandlingStep, ...]  # one after the other; all heights are given
    hands: str  # "both", "left", "right", or "one" for either
    # more is said than that something is taken from the floor, put down or carried, as people were captured
    said: bool = False
    repeated: bool = False  # it is done again and again

    @property
    def only_held(self) -> bool:
        """Whether a thing is held all the time."""
        return all(step.does == "hold" for step in self.steps)


Interaction = Handling | Contact | Terrain | Gaze
_Kind = TypeVar("_Kind", Handling, Contact, Terrain, Gaze)


class Reading(NamedTuple):
    """What one verb of a clause says."""

    meaning: Interaction  # in fields
    words: frozenset[int]  # the numbers of the words that say it
    alone: bool  # the clause says nothing else


def read_as(kind: type[_Kind], text: str) -> _Kind | None:
    """What a clause says of one kind of interaction; None where it says nothing of that, or something else beside it.

    Args:
        kind: `Contact`, `Terrain`, `Gaze` or `Handling`.
        text: In English.
    """
    return _read(kind, text)  # type: ignore[return-value, arg-type]


def interaction_of(text: str) -> Interaction | None:
    """What a clause says that is done with a thing, or what follows from where a person walks or looks; None where it
    says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    return next((meaning for kind in _READERS if (meaning := _read(kind, text))), None)


@functools.lru_cache(maxsize=4096)
def _read(kind: type, text: str) -> Interaction | None:
    return next((reading.meaning for reading in _READERS[kind](text) if reading.alone), None)


def says_more(detail: object) -> bool:
    """Whether it is an interaction, and more than what people were captured doing with things."""
    return isinstance(detail, Interaction) and (not isinstance(detail, Handling) or detail.said)


def thing_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that are understood by what things are."""
    return frozenset[int]().union(*(reading.words for reader in _READERS.values() for reading in reader(text)))


_THROUGH = "see through"
_GIVEN = frozenset(("portable",))
_NEAR = 4
"""Words after an animal among which the part of it is that is touched; chosen by eye."""


def _contacts(text: str) -> Iterator[Reading]:
    words, table, rows = words_of(text)[0], things(), lexicon().actions
    starts = {start for action, start in said_phrases(text)["actions"].items() if not rows[action].passing}
    for verb, deeds in verbs_in(words, table.verbs | dict.fromkeys(table.looks, _THROUGH)):
        zone = zone_of(words, verb)
        what, among = _meant(words, deeds, zone)
        thing = _thing_touched(words, among, what) if what else None
        by_hand = lexicon().grammar["hands"].intersection(words[zone.start : zone.stop])
        if thing is not None:
            contact = _contact(words, zone, thing.means.deeds[what], thing)
        elif what == "hold out" or (what in table.defaults and not by_hand):
            contact = _contact(words, zone, table.defaults[what], None)
        else:
            continue
        unknown = thing is not None and thing.means is table.unknown
        named = range(0) if thing is None or unknown else range(thing.start, thing.stop)
        alone = not does_else(text, verb, zone) and not (unknown and verb in starts)
        yield Reading(contact, frozenset((verb, *named)), alone)


def _meant(words: Sequence[str], what: str, zone: range) -> tuple[str, range]:
    """What a verb says is done, "" for nothing, and the words among which its thing is."""
    after, grammar = words[zone.start : zone.stop], lexicon().grammar
    hand = next((at for at in zone if words[at] in grammar["hands"]), -1)
    if what == _THROUGH:
        return (what if grammar["seen through"].intersection(after) else ""), zone
    if what in ("give", "hold", "reach out") and (what == "give" or "out" in after):
        near = object_of(words, zone)
        if hand == near.stop - 1 and len(near) < _NEAR:  # a hand alone, and no "hand signals"
            return "hold out", range(0)
    if what == "hold" and "out" in after:
        return "give", zone
    if what in ("lay", "press") and hand >= 0 and grammar["laid"].intersection(words[hand : zone.stop]):
        return "lay", range(hand + 1, zone.stop)
    if what == "lay" or (what == "lean" and not grammar["laid"].intersection(after)):
        return "", zone
    return what, zone


def _thing_touched(words: Sequence[str], zone: range, what: str) -> Named[Kind] | None:
    """The last thing in what the verb has first ("a car window"), or what that is of or on ("the neck of a camel"). For
    drinking it is any thing after the verb, and for what is not known the usual.
    """
    table, near = things(), object_of(words, zone)
    known = _done_with(words, near, what)
    if known:
        return known[-1]
    joint = words[near.stop] if near.stop < zone.stop else ""
    if joint in ("of", "on", "into"):
        of = _done_with(words, object_of(words, range(near.stop + 1, zone.stop)), what)
        known = [thing for thing in of if joint == "into" or not _GIVEN & thing.means.kinds]
    elif what in table.defaults or what == _THROUGH:
        known = _done_with(words, zone, what)
    if known:
        return known[0]
    named = named_in(table.kinds, words, near)
    if named or what not in table.unknown.deeds or not names_a_thing(words, near):
        return None
    return Named(near.start, near.stop, table.unknown)


def _done_with(words: Sequence[str], among: range, what: str) -> list[Named[Kind]]:
    """The things among some words that something is done with."""
    matching = [thing for thing in named_in(things().kinds, words, among) if what in thing.means.deeds]
    return [thing for thing in matching if _GIVEN & thing.means.kinds] if what == "give" else matching


def _contact(words: Sequence[str], zone: range, deed: str, thing: Named[Kind] | None) -> Contact:
    hands, way = named_hands(words), way_in(words, zone)
    if not hands and "hands" in words[zone.start : zone.stop]:
        hands = "both"
    if thing is None:
        return Contact(deed, hands or "one", way=way)
    kind = thing.means
    about = words[max(thing.start - _NEAR, zone.start) : min(thing.stop + _NEAR, zone.stop)]
    height = kind.head if kind.head and things().parts.intersection(about) else kind.height
    return Contact(deed, hands or kind.hands or "one", height, kind.surface, way)


def _terrains(text: str) -> Iterator[Reading]:
    words, starts = words_of(text)[0], said_phrases(text)["actions"]
    others = [starts[action] for action in actions_of(text) if action not in things().actions["walk"]]
    for verb, zone, terrain, by in _terrains_in(words):
        way = "way" in words[zone.start : by.start]  # "fights his way through"
        alone = all(zone.start < at < by.stop or (way and at == verb) for at in others)
        named = named_in(things().grounds, words, zone)
        yield Reading(terrain, frozenset((verb, *by, *(at for noun in named for at in noun.span))), alone)


def _terrains_in(words: Sequence[str]) -> Iterator[tuple[int, range, Terrain, range]]:
    """Each verb of walking, with what belongs to it, what is walked on, and the words that say it."""
    table = things()
    for verb, implied in verbs_in(words, table.walks):
        zone = zone_of(words, verb)
        for noun in named_in(table.grounds, words, zone):
            ends = lexicon().grammar["ends"].intersection(words[zone.start : noun.start]) or {implied}
            ground = next((ground for ground in noun.means if ends & ground.after), None)
            if ground is not None:
                yield verb, zone, Terrain(ground.name), noun.span
                break
        else:
            if words[verb] in table.verb_grounds:
                yield verb, zone, Terrain(table.verb_grounds[words[verb]]), range(zone.start, zone.start)
    for verb, what in verbs_in(words, table.verbs):
        zone = zone_of(words, verb)
        thing = next((one for one in reversed(_nouns(words, zone)) if what in one.means.going), None)
        if thing is not None:
            yield verb, zone, Terrain(thing.means.going[what], thing.means.height), thing.span


def _nouns(words: Sequence[str], zone: range) -> list[Named[Kind]]:
    """The things in what a verb has first."""
    return named_in(things().kinds, words, object_of(words, zone))


EYES, AWAY = 1.7, 1.6
"""Height of the eyes of a body of 1.84 m, and how far away a person stands from a thing that hands meet, chosen by eye
[m].
"""


def _gazes(text: str) -> Iterator[Reading]:
    words, table = words_of(text)[0], things()
    starts = said_phrases(text)["actions"]
    for verb, zone, seen in _gazes_in(words):
        shown = [action for action in actions_of(text) if starts[action] == verb]  # "looks around", a gesture
        alone = table.actions["look"].issuperset(shown) and not does_else(text, verb, zone)
        spans = [at for noun in named_in(table.gazes, words, zone) for at in noun.span]
        yield Reading(seen.means, frozenset((verb, *spans, *(seen.span if seen.means != table.level else ()))), alone)


def _gazes_in(words: Sequence[str]) -> Iterator[tuple[int, range, Named[Gaze]]]:
    """Each verb of looking with what belongs to it and what is seen, which is named after it or before it ("at a
    cliff and looks down"). A thing that hands meet is seen at its height, and an unknown one straight ahead.
    """
    table = things()
    for verb, _ in verbs_in(words, dict.fromkeys(table.looks, "")):
        zone = zone_of(words, verb)
        ways = [way for word in words[zone.start : zone.stop] for way in table.ways.get(word, ())]
        after, before = named_in(table.gazes, words, zone), named_in(table.gazes, words, range(verb))
        named = [Named(noun.start, noun.stop, _likeliest(noun.means, ways)) for noun in after]
        if not named:
            named = [Named(noun.start, noun.stop, gaze) for noun in before for name, gaze in noun.means if name in ways]
        near = object_of(words, zone)
        if not named and (table.looks[words[verb]] or "at" in ways):
            nouns = _nouns(words, zone)
            if nouns:
                down = math.degrees(math.atan2(EYES - nouns[-1].means.height, AWAY))
                named = [Named(nouns[-1].start, nouns[-1].stop, Gaze(down))]
            elif names_a_thing(words, near):
                named = [Named(near.start, near.start, table.level)]
        if named and words[zone.start] not in lexicon().grammar["sought"]:
            yield verb, zone, named[0]


def _likeliest(gazes: Sequence[tuple[str, Gaze]], ways: Sequence[str]) -> Gaze:
    """The gaze of the first way that a noun can be seen, or the likeliest."""
    return next((gaze for way in ways for name, gaze in gazes if name == way), gazes[0][1])


_PUT = frozenset(("floor", "low", "table", "high"))
"""Heights at which a carried thing is put down."""
_LONGEST_NAME = 6
"""Words of a thing's name at the most, its determiner included; chosen by eye."""


def _handlings(text: str) -> Iterator[Reading]:
    if not things().actions["handle"].issuperset(actions_of(text)):
        return
    words = words_of(text)[0]
    starts = [at for at in range(len(words)) if _handling_verb(words, at)]
    found: list[HandlingStep] = []
    kinds: list[Kind] = []
    for at, stop in zip(starts, [*starts[1:], len(words)], strict=False):
        part = _HandlingVerb.of(words, at, stop)
        if part.thing is not None or (found and (part.source or part.goal)):
            found += part.steps(found)
            kinds += _portable(part.thing or "")
    if not found:
        return
    small = any(_level(kind.height) == "table" for kind in kinds)
    hands, steps = named_hands(words), _with_heights(found, small)
    said = (
        (bool(hands) and not (hands == "both" and all(step.does == "hold" for step in found)))
        or {"take", "put"} <= {step.does for step in found}
        or any(_says_where(step) or (step.does == "take" and small) for step in found)
    )
    if not hands:
        far = any(step.place.height in ("overhead", "floor") for step in steps)
        taken = {kind.hands for kind in kinds}
        hands = "both" if "both" in taken or (far and taken <= {""}) else "one"
    repeated = "weights" in words or "weightlifting" in words
    yield Reading(Handling(tuple(steps), hands, said, repeated), frozenset(), True)


class _HandlingVerb(NamedTuple):
    """What is said of one verb: its kind, its thing (None for none), from where, to where, and where at all."""

    kind: str
    thing: str | None
    source: Place
    goal: Place
    at: Place
    particles: frozenset[str]

    @classmethod
    def of(cls, words: Sequence[str], at: int, stop: int) -> _HandlingVerb:
        kind, grammar = _handling_verb(words, at), lexicon().grammar
        thing, after = _thing_held(words, at + 1, stop, kind)
        places = {"from": Place(), "to": Place(), "at": Place()}
        mode = "at"
        for number in range(after, stop):
            word = words[number]
            if word in grammar["from"]:
                mode = "from"
            elif word in grammar["to"]:
                mode = "to"
            elif word in ("with", "using", "and", ",", "in", "at", "of") and mode == "to" and places["to"]:
                mode = "at"
            places[mode] = places[mode].or_else(_place(words, number))
        return cls(kind, thing, places["from"], places["to"], places["at"], frozenset(words[at + 1 : stop]))

    def steps(self, before: Sequence[HandlingStep]) -> list[HandlingStep]:
        """What this verb adds to what was done before."""
        held = bool(before) and before[-1].does != "put"
        first = [HandlingStep("take", self.source)] if self.source or not held else []
        goal = self.goal or self.at
        if self.kind == "take":
            source = self.source or self.at
            large = any(kind.hands == "both" for kind in _portable(self.thing or ""))
            if not (source.height or "up" in self.particles or large):
                source = Place("table", source.way)
            return [HandlingStep("take", source), HandlingStep("hold", self.goal)]
        if self.kind in ("lift", "raise"):
            usual = Place("chest" if self.kind == "lift" else "high")
            return [*first, HandlingStep("hold", goal.or_else(usual))]
        if self.kind == "hold" or (self.kind == "carry" and not (self.source or goal.way or goal.height in _PUT)):
            return [HandlingStep("hold", goal)]
        if self.kind == "put":
            goal = self.goal.or_else(self.at)
            taken = next((step.place for step in before if step.does == "take"), Place())
            if "back" in self.particles and taken:
                goal = goal or taken
            elif "down" in self.particles and not goal.height:
                goal = Place("down", goal.way)
            first = first if self.source or held else [HandlingStep("hold", Place())]
        return [*first, HandlingStep("put", goal)]


def _handling_verb(words: Sequence[str], at: int) -> str:
    """The kind of handling that a verb says; "" for none."""
    grammar = lexicon().grammar
    named = at > 0 and (words[at - 1] in grammar["determiners"] or words[at - 1] in grammar["before names"])
    return "" if named else lexicon().handling_verbs.get(words[at], "")


def _portable(thing: str) -> list[Kind]:
    """The kinds of things that are carried among some words."""
    words = thing.split()
    named = named_in(things().kinds, words, range(len(words)))
    return [noun.means for noun in named if "portable" in noun.means.kinds]


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
    while last < min(stop, at + _LONGEST_NAME) and words[last] not in grammar["ends"] and words[last].isalnum():
        last += 1
    named = words[at:last]
    listed = bool(_portable(" ".join(named)))
    if not named or not (named[0] in grammar["determiners"] or listed):
        return None, at
    clothes = last == stop - 1 and words[last] in ("on", "off")  # "puts a hat on"
    if clothes or any(stem(word) in body_stems() for word in named):
        return None, at
    unsure = stem(named[-1]) in action_stems() or len(named) < 2 or kind in ("hold", "raise", "move")
    return (None, at) if unsure and not listed else (" ".join(named), last)


def _place(words: Sequence[str], at: int) -> Place:
    """The place that a word says among others."""
    word, table = words[at], lexicon()
    after = words[at + 1] if at + 1 < len(words) else ""
    before = words[at - 1] if at else ""
    if word in ("left", "right"):
        of_hand = after in table.grammar["limbs"] or (after == "side" and before == "with")
        return Place() if of_hand else Place("", word)
    for height, phrases in table.heights.items():
        over = word != "head" or {"over", "above", "on"} & set(words[max(at - 4, 0) : at])
        if word in phrases and (over or height != "overhead"):
            return Place(height)
    kind = things().kinds.get(word)
    if kind is not None and kind.place:
        return Place(_level(kind.height))
    return Place("", "aside") if word in table.grammar["aside"] else Place()


def _says_where(step: HandlingStep) -> bool:
    """Whether a step says more than that a thing is taken from the floor, or put down there."""
    height, way = step.place
    usual = ("", "chest") if step.does == "hold" else ("", "floor", "down", "chest")
    return bool(way) or height not in usual


def _with_heights(steps: Sequence[HandlingStep], small: bool) -> list[HandlingStep]:
    """Steps with all heights: a cup stands on a table, and what is moved aside stays as high as it was."""
    start = "table" if small or any(step.place.way for step in steps) else "floor"
    found: list[HandlingStep] = []
    for step in steps:
        height, way = step.place
        if step.does != "put":
            height = height or (start if step.does == "take" else "chest")
        elif height in ("", "down"):
            taken = next((before.place.height for before in reversed(found) if before.does == "take"), "")
            height = taken or ("floor" if height == "down" and not small else "table")
        found.append(HandlingStep(step.does, Place(height, way)))
    return found


_READERS: dict[type, Callable[[str], Iterator[Reading]]] = {
    Terrain: _terrains, Contact: _contacts, Gaze: _gazes, Handling: _handlings,
}  # fmt: skip
"""In the order in which they are asked."""


def with_names(clauses: Sequence[str]) -> list[str]:
    """Clauses in a row with the thing of the clause before in place of "it", where something is done with that: "walks
    to the window", "opens the window".
    """
    texts: list[str] = []
    last = ""
    for text in clauses:
        words, spans = words_of(text)
        for verb, _ in verbs_in(words, things().verbs):
            near = object_of(words, zone_of(words, verb))
            named = words[near.start : near.stop]
            if last and (named in (["it"], ["them"]) or named[:1] == ["its"]):
                start, stop = spans[near.start]
                of = "'s" if named[0] == "its" else ""
                said = f"{text[:start]}the {last}{of}{text[stop:]}"
                text = said if read_as(Contact, said) else text
                break
        texts.append(text)
        nouns = named_in(things().kinds, words, range(len(words)))
        last = " ".join(words[nouns[-1].start : nouns[-1].stop]) if nouns else last
    return texts
