"""What somebody looks at: where the head goes follows from what is seen (the table `lexicon.things`)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

from bunraku.language.lexicon.reading import actions_of, said_phrases, words_of
from bunraku.language.lexicon.tables import lexicon
from bunraku.language.lexicon.things import Named, Sight, named_in, things
from bunraku.language.phrasing import does_else, names_a_thing, object_of, verbs_in, zone_of

__all__ = ["sight_of", "sight_words"]

EYES, AWAY = 1.7, 1.6
"""How high eyes are, and how far away somebody stands who looks at a thing that hands meet [m]."""


@functools.lru_cache(maxsize=1024)
def sight_of(text: str) -> Sight | None:
    """Where a clause says that somebody looks; None where it says nothing of that, or something else beside it. What is
    not known is straight ahead.

    Args:
        text: In English.
    """
    words = words_of(text)[0]
    starts = said_phrases(text)["actions"]
    for verb, zone, seen in _found(words):
        shown = [action for action in actions_of(text) if starts[action] == verb]  # "looks around", a gesture
        if things().actions["look"].issuperset(shown) and not does_else(text, verb, zone):
            return seen.means
    return None


def sight_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that say what is looked at."""
    words, found = words_of(text)[0], set[int]()
    for verb, zone, seen in _found(words):
        some = [(one.start, one.stop) for one in named_in(things().sights, words, zone.start, zone.stop)]
        some += [(seen.start, seen.stop)] if seen.means != things().level else []
        found.update((verb, *(at for ends in some for at in range(*ends))))
    return frozenset(found)


def _found(words: Sequence[str]) -> list[tuple[int, range, Named[Sight]]]:
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
                named = [Named(known[-1].start, known[-1].stop, Sight(down))]
            elif names_a_thing(words, near):
                named = [Named(near.start, near.start, table.level)]
        if named and words[zone.start] not in lexicon().grammar["sought"]:
            found.append((verb, zone, named[0]))
    return found
