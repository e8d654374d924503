"""English for captions: phrases with their verbs in braces, such as "slowly {walk} forward and {turn}", as whole
sentences.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable

__all__ = ["conjugate", "fill", "is_stative", "sentence_forms"]

_VERB = re.compile(r"\{(\w+)\}")
_DOUBLED = {
    "beg", "begin", "bob", "chat", "chop", "clap", "cut", "dig", "dip", "drag", "drop", "fit", "flap", "flip", "flop",
    "get", "grab", "hit", "hop", "hug", "jab", "jog", "jut", "let", "lug", "mop", "nap", "nod", "pad", "pat", "peg",
    "pin", "plan", "plod", "pop", "put", "ram", "rip", "rub", "run", "scan", "scrub", "set", "shrug", "shut",
    "sidestep", "sip", "sit", "skip", "slam", "slap", "slip", "snap", "spar", "spin", "squat", "stab", "step", "stop",
    "strut", "stun", "swat", "swim", "tap", "tip", "trip", "trot", "wag", "whip", "win", "wrap", "zigzag",
}  # fmt: skip
_GERUNDS = {
    "lie": "lying",
    "die": "dying",
    "be": "being",
    "tiptoe": "tiptoeing",
    "panic": "panicking",
    "boogie": "boogieing",
    "mimic": "mimicking",
}
_THIRD = {"be": "is", "do": "does", "go": "goes", "have": "has", "undergo": "undergoes"}

_ALWAYS = ("a person {third}", "a person is {gerund}", "{plain}", "{third}", "{gerund}")
_SOMETIMES = (
    "someone {third}", "the character {third}", "a human {third}", "the person {third}", "he {third}", "she {third}",
    "a man {third}", "a woman {third}", "somebody {third}", "the figure {third}", "it {third}",
    "the character is {gerund}",
    "someone is {gerund}", "a character {gerund}", "he is {gerund}", "she is {gerund}", "a person {gerund}",
    "make the character {plain}",
    "can you make it {plain}", "please {plain}", "let the person {plain}", "make it {plain}", "this person {third}",
    "a guy {third}",
)  # fmt: skip
# of the second list, a few for each phrase: all of them for all would be tens of thousands of sentences to encode
_DRAWN = 4


def _gerund(verb: str) -> str:
    if verb in _GERUNDS:
        return _GERUNDS[verb]
    if verb in _DOUBLED:
        return verb + verb[-1] + "ing"
    if verb.endswith("e") and not verb.endswith(("ee", "oe", "ye")):
        return verb[:-1] + "ing"
    return verb + "ing"


def _third(verb: str) -> str:
    if verb in _THIRD:
        return _THIRD[verb]
    if verb.endswith(("s", "x", "z", "ch", "sh")):
        return verb + "es"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        return verb[:-1] + "ies"
    return verb + "s"


def conjugate(phrase: str, form: str) -> str:
    """A phrase with its verbs in one form.

    Args:
        phrase: Words with the verbs in braces.
        form: "plain" (walk), "third" (walks) or "gerund" (walking).
    """
    change: dict[str, Callable[[str], str]] = {"plain": str, "third": _third, "gerund": _gerund}
    return _VERB.sub(lambda match: change[form](match.group(1)), phrase)


def is_stative(phrase: str) -> bool:
    """Whether the progressive of a phrase is no English: nobody "is being angry"."""
    return phrase.startswith("{be}")


def fill(frame: str, phrase: str) -> str:
    """A frame such as "someone is {gerund}" with the phrase in that form."""
    return _VERB.sub(lambda match: conjugate(phrase, match.group(1)), frame)


def sentence_forms(phrase: str) -> list[str]:
    """A phrase as sentences about people: third person, progressive, imperative, gerund, and a few more drawn by its
    spelling.

    Args:
        phrase: Words with the verbs in braces.
    """
    first = zlib.crc32(phrase.encode())
    frames = [*_ALWAYS, *(_SOMETIMES[(first + 5 * step) % len(_SOMETIMES)] for step in range(_DRAWN))]
    return [fill(frame, phrase) for frame in frames if not (is_stative(phrase) and "gerund" in frame)]
