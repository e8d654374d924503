"""The few words that decide what a viewer sees, read by rule: which side, which way, how far, how often, how fast.

A sentence encoder that was trained on meaning hardly tells "left" from "right": the vectors of two sentences that
differ in nothing else have a cosine of 0.98. These numbers stand beside them.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

import numpy as np

__all__ = ["CUES", "said_cues", "sentence_cues"]

_ARM = r"hands?|arms?|fists?|wrists?|elbows?|shoulders?|palms?|punch\w*|jabs?|hooks?|uppercuts?|cross|fingers?|biceps?"
_LEG = r"foot|feet|legs?|knees?|ankles?|heels?|toes?|thighs?|hips?|shins?|kicks?|lunges?"
_REACHING = (
    r"wav\w+|punch\w*|jab\w*|hook\w*|throw\w*|tos\w+|catch\w*|point\w*|rais\w+|reach\w*|swing\w*|slap\w*|grab\w*"
)
_TURNING = r"turn\w*|spin\w*|rotat\w+|twirl\w*|pivot\w*|circl\w*|curv\w*|veer\w*|swerv\w*|arc\w*|twist\w*|pirouett\w*"
_KICKING = r"kick\w*|hop\w*|balanc\w*|stand\w*"
_GOING = r"walk\w*|step\w*|run\w*|jog\w*|mov\w+|go(es|ing)?|shuffl\w*|jump\w*|leap\w*|lean\w*|bend\w*|slid\w+|dodg\w+"
_VERBS = (("arm", _REACHING), ("turn", _TURNING), ("leg", _KICKING), ("go", _GOING))
_PLACES = ("arm", "leg", "turn", "go")
_WORDS = re.compile(r"[a-z0-9]+")
_TURN_NOUN = r"turns?|spins?|pirouettes?|circles?|curve|arc|twirls?|about"

_RULES: tuple[tuple[str, str], ...] = (
    ("both arms", rf"\bboth (of )?(the |its |his |her |their )?({_ARM})\b|\b(arms|hands|fists)\b"),
    ("both legs", rf"\bboth (of )?(the |its |his |her |their )?({_LEG})\b|\b(legs|feet|knees)\b"),
    ("forward", r"\b(forwards?|ahead|onwards?)\b"),
    ("backwards", r"\b(backwards?|backs? (up|away)|(walk|step|move|run|hop|jump|shuffl)\w* back)\b"),
    ("sideways", r"\b(sideways|aside|sidesteps?|side ?steps?|to (the|one|its|his|her|their) side)\b"),
    ("quarter", r"\b(quarter|90|ninety)\b"),
    ("half", r"\b(around|round|half[ -]turns?|about[ -](face|turn)|180|u-?turns?|other way|there and back)\b"),
    ("full", r"\b(full|360|all the way|spin\w*|twirl\w*|several times around|circles?)\b"),
    ("once", r"\b(once|single|one (time|step|kick|jump|punch|turn|squat))\b"),
    ("twice", r"\b(twice|two|double)\b"),
    ("thrice", r"\b(three|thrice)\b"),
    ("often", r"\b(four|five|six|several|repeated\w*|many|more than (once|twice)|again and again|times)\b"),
    ("slow", r"\b(slow\w*|calm\w*|gent\w+|careful\w*|leisure\w*|stroll\w*)\b"),
    ("fast", r"\b(fast\w*|quick\w*|rapid\w*|brisk\w*|sprint\w*|hurr\w+|dash\w*)\b"),
    ("in place", r"\b(in place|on the spot)\b"),
    ("high", r"\b(high|above|overhead|over (the|his|her|their) head)\b"),
    ("low", r"\b(low|down|deep\w*)\b"),
    ("sits", r"\b(sits?|sitting|seats?|seated|sat)\b"),
    ("gets up", r"\b((stands?|gets?|getting|standing|back|jumps?) up|rises?|rising)\b"),
    ("lies", r"\b(lies?|lying|floor|ground)\b"),
    ("still", r"\b(still|idles?|waits?|stays?|freez\w+)\b"),
    ("then", r"\b(then|after|before|finally)\b|,"),
)

CUES: tuple[str, ...] = (
    *(f"{side} {place}" for place in _PLACES for side in ("left", "right")),
    *(name for name, _ in _RULES),
)
"""What the numbers of `sentence_cues` stand for."""


@functools.cache
def _matcher(pattern: str) -> Callable[[str], bool]:
    compiled = re.compile(pattern)
    return lambda text: compiled.search(text) is not None


@functools.cache
def _whole(pattern: str) -> re.Pattern[str]:
    return re.compile(rf"(?:{pattern})\Z")


def _place_of(words: list[str], at: int) -> str:
    """What the side at this word is the side of: the noun right after it, else the nearest verb before it, else one
    after it.
    """
    for word in words[at + 1 : at + 3]:
        if _whole(_TURN_NOUN).match(word):
            return "turn"
        if _whole(_LEG).match(word):
            return "leg"
        if _whole(_ARM).match(word):
            return "arm"
    for word in [*reversed(words[:at]), *words[at + 1 :]]:
        for place, pattern in _VERBS:
            if _whole(pattern).match(word):
                return place
    return "go"


def sentence_cues(sentence: str) -> np.ndarray:
    """What a sentence says of sides, directions, turns, counts, speeds and postures.

    The cues of a sentence with left and right exchanged are the cues with their sides exchanged.

    Args:
        sentence: In English.

    Returns:
        One for each of `CUES` that is said, else zero, shape (30,), float32.
    """
    text = sentence.lower()
    words = _WORDS.findall(text)
    found = np.zeros(len(CUES), np.float32)
    for at, word in enumerate(words):
        if word in ("left", "right"):
            found[CUES.index(f"{word} {_place_of(words, at)}")] = 1
        elif word in ("clockwise", "counterclockwise", "anticlockwise"):
            found[CUES.index(f"{'right' if word == 'clockwise' else 'left'} turn")] = 1
    for index, (_, pattern) in enumerate(_RULES, start=2 * len(_PLACES)):
        found[index] = _matcher(pattern)(text)
    return found


def said_cues(sentence: str) -> frozenset[str]:
    """The names of the cues that a sentence has."""
    return frozenset(cue for cue, value in zip(CUES, sentence_cues(sentence), strict=True) if value)
