"""Things that a sentence says are taken, held and put somewhere: by which hands, from where, and to where.

The words are those of the lexicon's table `handling`. What is done with a part of the body ("raises the arm") or is no
thing ("takes a step") is not handled.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bunraku.language.details import body_stems
from bunraku.language.known.vocabulary import action_stems, stem
from bunraku.language.lexicon.reading import actions_of, words_of
from bunraku.language.lexicon.tables import lexicon
from bunraku.language.lexicon.things import Kind, named_in
from bunraku.language.lexicon.things import things as known_things
from bunraku.language.phrasing import named_hands

__all__ = ["Handling", "Place", "Station", "handling_of"]

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


class Station(NamedTuple):
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

    stations: tuple[Station, ...]
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
    found: list[Station] = []
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
        thing, after = _thing(words, at + 1, stop, kind)
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

    def stations(self, before: Sequence[Station]) -> list[Station]:
        """What this verb adds to what was done before."""
        held = bool(before) and before[-1].does != "put"
        away = [Station("take", self.source)] if self.source or not held else []
        goal = self.goal or self.at
        if self.kind == "take":
            source = self.source or self.at
            if not (source.height or self.up or any(kind.hands == "both" for kind in _kinds(self.thing or ""))):
                source = Place("table", source.way)
            return [Station("take", source), Station("hold", self.goal)]
        if self.kind in ("lift", "raise"):
            own = Place("chest" if self.kind == "lift" else "high")
            there = goal if goal.height else _added(goal, own)
            return [*away, Station("hold", there)]
        if self.kind == "hold" or (self.kind == "carry" and not (self.source or goal.way or goal.height in _PUT)):
            return [Station("hold", goal)]
        if self.kind == "put":
            goal = _added(self.goal, self.at)
            taken = next((one.place for one in before if one.does == "take"), Place())
            if self.back and taken:
                goal = goal or taken
            elif self.down and not goal.height:
                goal = Place("down", goal.way)
            start = [Station("take", self.source)] if self.source else [] if held else [Station("hold", Place())]
            return [*start, Station("put", goal)]
        return [*away, Station("put", goal)]


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


def _thing(words: Sequence[str], at: int, stop: int, kind: str) -> tuple[str | None, int]:
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


def _tells(station: Station) -> bool:
    """Whether a station says more than that a thing is taken from the floor, or put down there."""
    height, way = station.place
    return bool(way) or (station.does == "hold" and bool(height) and height != "chest") or height not in (
        "", "floor", "down", "chest",
    )  # fmt: skip


def _whole(stations: Sequence[Station], small: bool) -> list[Station]:
    """Stations whose heights are all said: a cup stands on a table, and what is moved aside stays as high as it was."""
    moved = any(one.place.way for one in stations)
    start = "table" if small or moved else "floor"
    found: list[Station] = []
    for one in stations:
        height, way = one.place
        if one.does == "take":
            height = height or start
        elif one.does == "hold":
            height = height or "chest"
        elif height in ("", "down"):
            taken = next((before.place.height for before in reversed(found) if before.does == "take"), "")
            height = taken or ("floor" if height == "down" and not small else "table")
        found.append(Station(one.does, Place(height, way)))
    return found
