"""What the body does by the thing that a clause names, in one of four forms."""

from __future__ import annotations

from collections.abc import Sequence

from bunraku.language.contact import Contact, contact_of, contact_words
from bunraku.language.footing import Footing, footing_of, footing_words
from bunraku.language.handling import Handling, handling_of
from bunraku.language.lexicon.reading import words_of
from bunraku.language.lexicon.things import Sight, named_in, things
from bunraku.language.phrasing import object_of, verbs_in, zone_of
from bunraku.language.sight import sight_of, sight_words

__all__ = ["Told", "says_more", "thing_words", "told_of", "with_names"]

Told = Handling | Contact | Footing | Sight


def told_of(text: str) -> Told | None:
    """What a clause says that is done with a thing, or what follows from where somebody walks or looks; None where it
    says nothing of that, or something else beside it.

    Args:
        text: In English.
    """
    return footing_of(text) or contact_of(text) or sight_of(text) or handling_of(text)


def says_more(told: object) -> bool:
    """Whether it is one of the forms of `Told`, and more than what people were captured doing with things."""
    return isinstance(told, Told) and (not isinstance(told, Handling) or told.said)


def thing_words(text: str) -> frozenset[int]:
    """The numbers of the words of a text that are understood by what things are."""
    return footing_words(text) | contact_words(text) | sight_words(text)


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
