"""Words that captions of training hardly have, in the words that they have for the same movement.

A sentence encoder takes "twirls" for a way of walking; what is asked of the network and of the examples is "spins".
"""

from __future__ import annotations

import functools
import re

from bunraku.language.captions.grammar import conjugate

__all__ = ["in_known_words"]

_BALL = "(?: an?| the)? (?:basket ?)?ball"
_HANDS = "(?: (?:both|his|her|their|its|the))? (?:hands|arms)"
_MAKE = "(?:{make}|{do}|{perform})"
_PHRASES = (
    ("{sneak} a (?:look|peek|glance)", "{look}"),
    ("{glance}", "{look}"),
    ("{peer}", "{look}"),
    ("{saunter}", "{stroll}"),
    ("{amble}", "{stroll}"),
    ("at an? (?:leisurely|relaxed|easy|gentle|slow) pace", "slowly"),
    ("{lower} (?:him|her|it|them|one)sel(?:f|ves) (?:down )?(?:on|in)to", "{sit} down on"),
    ("{plop} down", "{sit} down"),
    (
        "(?:{go}|{get}|{drop}) down on (?:all fours|(?:(?:the|his|her|their|its) )?hands and knees) and {crawl}",
        "{crawl} on all fours",
    ),
    ("{twirl}", "{spin}"),
    ("{whirl}", "{spin}"),
    (f"{_MAKE} a (?:quarter|ninety degree|90[ -]degree) turn(?: to)?(?: (?:the|his|her|their|its))?", "{turn}"),
    (f"{_MAKE} (?:a half|an about|a u) turn", "{turn} around"),
    ("{climb} (?:up )?a flight of (?=stairs|steps)", "{climb} "),
    ("{trip} and (?:nearly|almost) (?:falls?|falling)(?: (?:over|down))?", "{stumble}"),
    ("{balance} on (?=one|a single|(?:the|his|her|their) (?:left|right) (?:leg|foot))", "{stand} on "),
    ("{pirouette}", "{spin}"),
    ("{spin} (?:a)?round (?:to face|and face)", "{turn} around to face"),
    (f"{{bounce}}{_BALL}", "{dribble} a basketball"),
    ("{dunk}", "{shoot} a basketball"),
    ("{applaud}", "{clap}"),
    ("{hurl}", "{throw}"),
    ("{fling}(?! (?:his|her|their|its|the|both) (?:arms|hands))", "{throw}"),
    ("{totter}", "{stagger}"),
    ("{wobble}", "{stagger}"),
    ("(?:{walk}|{tread}|{move}) on (?:(?:the|his|her|their|its) )?(?:tip-?)?toes", "{sneak}"),
    ("{tiptoe}", "{sneak}"),
    ("{hobble}", "{limp}"),
    ("{hurdle}", "{jump} over"),
    ("{vault}(?: over)?", "{jump} over"),
    ("{genuflect}", "{kneel} down"),
    ("{faint}", "{fall} down"),
    ("{collapse}", "{fall} down"),
    ("{snatch}", "{grab}"),
    ("{peek}", "{look}"),
)
"""Verbs in braces stand for all their forms; the rest of what is looked for is a pattern."""
_FORMS = ("third", "gerund", "plain")
_VERB = re.compile(r"\{(\w+)\}")


@functools.cache
def _patterns() -> tuple[tuple[re.Pattern[str], str], ...]:
    """Each phrase in each form, and what is said in its place."""
    found = []
    for said, known in _PHRASES:
        for form in _FORMS:
            text = _VERB.sub(lambda verb, form=form: conjugate(verb.group(), form), said)  # type: ignore[misc]
            found.append((re.compile(rf"\b{text}\b", re.IGNORECASE), conjugate(known, form)))
    return tuple(found)


def in_known_words(sentence: str) -> str:
    """A sentence in English with rare words for movements put into those that training has."""
    for pattern, known in _patterns():
        sentence = pattern.sub(known, sentence)
    return sentence
