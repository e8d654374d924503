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

__all__ = ["Handling", "Place", "Station", "handling_of"]

_HANDLED = frozenset(("handle", "pick up", "put down", "carry", "reach"))
"""Actions that say no more than that a thing is handled."""
_FROM = frozenset(("from", "off"))
_TO = frozenset(("to", "onto", "into", "over", "above", "towards", "toward", "till"))
_ENDS = frozenset((
    "and", "then", "while", "before", "after", ",", ".", ";", "with", "from", "off", "to", "onto", "into", "over",
    "above", "on", "in", "at", "under", "beside", "near", "next", "behind", "towards", "toward", "up", "down", "back",
    "away", "out", "using", "until", "as", "for",
))  # fmt: skip
_PARTICLES = frozenset(("up", "down", "back", "away", "out"))
_WORN = frozenset(("on", "off"))
"""After a verb, without a thing: something that is worn."""
_PRONOUNS = frozenset(("it", "them", "something", "anything", "things", "stuff", "one"))
_DETERMINERS = frozenset((
    "a", "an", "the", "his", "her", "their", "its", "some", "this", "that", "these", "those", "another", "one", "two",
    "your", "my",
))  # fmt: skip
_BEFORE_NAMES = _DETERMINERS | {"from", "off", "on", "at", "in", "of", "with"}
"""After these no verb stands: "from lower ground"."""
_LIMBS = frozenset(("hand", "hands", "arm", "arms"))
_TOUCHED = frozenset(("floor", "low", "table"))
"""Heights at which hands are laid on something that is no part of the body."""
_PUT = frozenset(("floor", "low", "table", "high"))
"""Heights at which something is put down by who carries it there."""
_MOST = 6
"""Words of a thing's name at the most, its determiner included."""


class Place(NamedTuple):
    """Where a thing is.

    Args:
        height: Of `[places]` in `gestures.toml`; "" where nothing is said of it.
        way: "left", "right", "aside" for either of them; "" for straight ahead.
    """

    height: str = ""
    way: str = ""

    def __bool__(self) -> bool:
        return bool(self.height or self.way)


class Station(NamedTuple):
    """One thing that is done with what is handled.

    Args:
        does: "take", "hold" or "put"; "touch" of hands alone.
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
    things = []
    for segment in segments:
        if segment.thing is None and not (found and (segment.source or segment.goal)):
            continue
        found += segment.stations(found)
        things.append(segment.thing or "")
    if not found:
        return None
    kinds = {kind for kind in ("both", "one", "table") if any(_is(thing, kind) for thing in things)}
    hands = _hands(words)
    stations = _whole(found, "table" in kinds)
    held = all(one.does == "hold" for one in found)
    said = (
        (bool(hands) and not (held and hands == "both"))
        or {"take", "put"} <= {one.does for one in found}
        or any(map(_tells, found))
        or any(one.does == "take" and "table" in kinds for one in found)
    )
    if not hands:
        far = any(one.place.height in ("overhead", "floor") for one in stations)
        hands = "both" if "both" in kinds or (far and not kinds) else "one"
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
        if thing is None and kind == "put" and words[stop - 1] not in _LIMBS and _LIMBS.intersection(words[at:stop]):
            kind, thing = "touch", ""
        places = {"from": Place(), "to": Place(), "at": Place()}
        mode = "at"
        own = words[at + 1 : stop]
        for number in range(after, stop):
            word = words[number]
            if word in _FROM:
                mode = "from"
            elif word in _TO:
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
            if not (source.height or self.up or _is(self.thing or "", "both")):
                source = Place("table", source.way)
            return [Station("take", source), Station("hold", self.goal)]
        if self.kind in ("lift", "raise"):
            own = Place("chest" if self.kind == "lift" else "high")
            there = goal if goal.height else _added(goal, own)
            return [*away, Station("hold", there)]
        if self.kind == "touch":
            return [Station("touch", goal)] if goal.height in _TOUCHED else []
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
    named = at > 0 and words[at - 1] in _BEFORE_NAMES
    return "" if named else lexicon().handling_verbs.get(words[at], "")


def _is(thing: str, kind: str) -> bool:
    return bool(set(thing.split()) & lexicon().things[kind])


def _listed(word: str) -> bool:
    return any(word in some for some in lexicon().things.values())


def _thing(words: Sequence[str], at: int, stop: int, kind: str) -> tuple[str | None, int]:
    """The words for what is handled, None where no thing is named, and the number of the word after them."""
    while at < stop and (words[at] in _PARTICLES or words[at].endswith("ly")):
        at += 1
    if at < stop and words[at] in _PRONOUNS:
        return words[at], at + 1
    last = at
    while last < min(stop, at + _MOST) and words[last] not in _ENDS and words[last].isalnum():
        last += 1
    named = words[at:last]
    listed = any(map(_listed, named))
    if not named or not (named[0] in _DETERMINERS or listed):
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
        return Place() if after in _LIMBS or (after == "side" and before == "with") else Place("", word)
    for height, said in lexicon().heights.items():
        if word in said:
            near = words[max(at - 4, 0) : at]
            if height == "overhead" and word == "head" and not {"over", "above", "on"} & set(near):
                continue
            return Place(height)
    return Place("", "aside") if word in lexicon().aside else Place()


def _added(place: Place, other: Place) -> Place:
    return Place(place.height or other.height, place.way or other.way)


def _tells(station: Station) -> bool:
    """Whether a station says more than that a thing is taken from the floor, or put down there."""
    height, way = station.place
    return bool(way) or (station.does == "hold" and bool(height) and height != "chest") or height not in (
        "", "floor", "down", "chest",
    )  # fmt: skip


def _hands(words: Sequence[str]) -> str:
    """The hands that are named: "both", "left", "right", "one", or "" for none."""
    for at, word in enumerate(words):
        after = words[at + 1 : at + 3]
        if word in ("both", "two") and _LIMBS.intersection(after):
            return "both"
        if word == "hands" and _verb(words, at - 1 - (words[at - 1] in _DETERMINERS)) == "put":
            return "both"
        if word in ("left", "right", "one", "single") and after and after[0] in _LIMBS:
            return "one" if word == "single" else word
    return ""


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
