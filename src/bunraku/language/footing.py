"""What somebody walks on or in, and with what: deep snow, a rope, ice, a hill, a cart that is pushed. How that makes
somebody walk follows from it (the table `lexicon.things`, and `[grounds]` of `things.toml`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

from bunraku.language.lexicon.reading import actions_of, said_phrases, words_of
from bunraku.language.lexicon.tables import lexicon
from bunraku.language.lexicon.things import named_in, things
from bunraku.language.phrasing import object_of, verbs_in, zone_of

__all__ = ["Footing", "footing_of", "footing_words"]


class Footing(NamedTuple):
    """How somebody walks.

    Args:
        ground: Of `[grounds]` in `things.toml`.
        height: Where both palms are that push or pull something [m]; 0 for arms that do nothing of the kind.
    """

    ground: str
    height: float = 0.0


@functools.lru_cache(maxsize=1024)
def footing_of(text: str) -> Footing | None:
    """What a clause says that somebody walks on, in, or with; None where it says nothing of that, or something else
    beside it.

    Args:
        text: In English.
    """
    words, starts = words_of(text)[0], said_phrases(text)["actions"]
    for verb, zone, footing, own in _found(words):
        way = "way" in words[zone.start : own.start]  # "fights his way through"
        others = [action for action in actions_of(text) if action not in things().actions["walk"]]
        if all(zone.start < starts[one] < own.stop or (way and starts[one] == verb) for one in others):
            return footing
    return None


def footing_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is walked on, in, or with."""
    words, found = words_of(text)[0], set[int]()
    for verb, zone, _, own in _found(words):
        named = named_in(things().grounds, words, zone.start, zone.stop)
        found.update((verb, *own, *(at for one in named for at in range(one.start, one.stop))))
    return frozenset(found)


def _found(words: Sequence[str]) -> list[tuple[int, range, Footing, range]]:
    """Each verb of walking, with what belongs to it, how that makes somebody walk, and the words that say it."""
    table, found = things(), []
    for verb, implied in verbs_in(words, table.walks):
        zone = zone_of(words, verb)
        for start, stop, meant in named_in(table.grounds, words, zone.start, zone.stop):
            said = lexicon().grammar["ends"].intersection(words[zone.start : start]) or {implied}
            own = next((one for one in meant if said & one.after), None)
            if own is not None:
                found.append((verb, zone, Footing(own.name), range(start, stop)))
                break
        else:
            if words[verb] in table.treads:
                found.append((verb, zone, Footing(table.treads[words[verb]]), range(zone.start, zone.start)))
    for verb, what in verbs_in(words, table.verbs):
        zone = zone_of(words, verb)
        near = object_of(words, zone)
        for start, stop, kind in reversed(named_in(table.kinds, words, near.start, near.stop)):
            if what in kind.going:
                found.append((verb, zone, Footing(kind.going[what], kind.height), range(start, stop)))
                break
    return found
