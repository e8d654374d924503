"""What hands do with a thing where it is: a dog is patted, a door opened, a button pressed, a letter given.

Which thing, how high it is and what is done with it is knowledge of the table `lexicon.things`. Things that are taken
from place to place are for `handling`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

from bunraku.language.lexicon.reading import said_phrases, words_of
from bunraku.language.lexicon.tables import lexicon
from bunraku.language.lexicon.things import Kind, Named, named_in, things
from bunraku.language.phrasing import does_else, named_hands, names_a_thing, object_of, verbs_in, way_in, zone_of

__all__ = ["Contact", "contact_of", "contact_words"]

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
    for verb, zone, deed, thing in _found(words):
        known = thing is None or thing.means is not things().unknown
        if not does_else(text, verb, zone) and (known or verb not in starts):
            return _made(words, zone, deed, thing)
    return None


def contact_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is done with things."""
    found: set[int] = set()
    for verb, _, _, thing in _found(words_of(text)[0]):
        known = thing is not None and thing.means is not things().unknown
        found.update((verb, *(range(thing.start, thing.stop) if thing and known else ())))
    return frozenset(found)


def _found(words: Sequence[str]) -> list[tuple[int, range, str, Named[Kind] | None]]:
    """Each verb of a text whose deed is known: its number, what belongs to it, the deed, and the thing."""
    table = things()
    found: list[tuple[int, range, str, Named[Kind] | None]] = []
    for verb, said in verbs_in(words, table.verbs | dict.fromkeys(table.looks, _THROUGH)):
        zone = zone_of(words, verb)
        what, goes = _meant(words, said, zone)
        thing = _thing(words, goes, what) if what else None
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


def _thing(words: Sequence[str], zone: range, what: str) -> Named[Kind] | None:
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
