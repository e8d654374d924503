"""The few words that decide what a viewer sees, read by rule: which side, which way, how far, how often, how fast.

A sentence encoder that was trained on meaning hardly tells "left" from "right": the vectors of two sentences that
differ in nothing else have a cosine of 0.98. These numbers stand beside them.
"""

from __future__ import annotations

import numpy as np

from bunraku.language.lexicon.reading import said_phrases, words_of
from bunraku.language.lexicon.tables import lexicon

__all__ = ["CUES", "said_cues", "sentence_cues"]

_PLACES = ("arm", "leg", "turn", "go")
_VERBS = (("arm", "arm verb"), ("turn", "turn verb"), ("leg", "leg verb"), ("go", "go verb"))
_NOUNS = (("turn", "turn noun"), ("leg", "leg"), ("arm", "arm"))

CUES: tuple[str, ...] = (
    *(f"{side} {place}" for place in _PLACES for side in ("left", "right")),
    *lexicon().names["cues"],
)
"""What the numbers of `sentence_cues` stand for."""


def _place_of(words: list[str], at: int) -> str:
    """What the side at this word is the side of: the noun right after it, else the nearest verb before it, else one
    after it; of who does something "to the left" never a leg.
    """
    known = lexicon().places
    aside = words[max(at - 2, 0) : at] == ["to", "the"]
    for word in words[at + 1 : at + 3]:
        for part, noun in _NOUNS:
            if word in known[noun]:
                return part
    for word in [*reversed(words[:at]), *words[at + 1 :]]:
        for part, verb in _VERBS:
            if word in known[verb]:
                return "go" if part == "leg" and aside else part
    return "go"


def sentence_cues(sentence: str) -> np.ndarray:
    """What a sentence says of sides, directions, turns, counts, speeds and postures.

    The cues of a sentence with left and right exchanged are the cues with their sides exchanged.

    Args:
        sentence: In English.

    Returns:
        One for each of `CUES` that is said, else zero, shape (30,), float32.
    """
    said = said_cues(sentence)
    return np.array([cue in said for cue in CUES], np.float32)


def said_cues(sentence: str) -> frozenset[str]:
    """The names of the cues that a sentence has."""
    found = set(said_phrases(sentence)["cues"])
    words = [word for word in words_of(sentence)[0] if word.isalnum()]
    for at, word in enumerate(words):
        if word in ("left", "right"):
            found.add(f"{word} {_place_of(words, at)}")
        elif word in ("clockwise", "counterclockwise", "anticlockwise"):
            found.add("right turn" if word == "clockwise" else "left turn")
    return frozenset(found)
