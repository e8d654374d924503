"""What happens at the same time in a sentence: "walks while waving" is walking, and arms that wave.

Hardly any capture shows a gesture of the arms or the head on the way, so the network does one of both. Where a sentence
joins a movement of the legs and one of the arms or the head, two motions are denoised side by side. The first is
conditioned on the legs' words, the second on the gesture's; at each step the second is given all but the gesture's
handles by the first, as an edit that keeps them is (section A.3 of TapMo).
"""

from __future__ import annotations

import re

from bunraku.language.actions import actions_of
from bunraku.language.captions.grammar import conjugate
from bunraku.language.clauses import subject_of, with_subject
from bunraku.language.gestures import GESTURE_WORDS

__all__ = ["moved_part", "split_voices"]

_LEGS = (
    "walk", "run", "jog", "sprint", "march", "sneak", "tiptoe", "skip", "stroll", "stride", "hop", "jump", "trot",
    "stomp", "wander", "sit", "kneel", "stand",
)  # fmt: skip
_ARMS = ("wave", "clap", "applaud", "salute", "cheer", "point", "beckon", "drink", "greet")
_HEAD = ("nod",)
_WHOLE = {
    "look around", "propose", "kneel", "both knees", "pitch", "bat", "tennis", "serve", "march in place",
    "run in place", "zombie", "stumble", "jump over", "ladder",
}  # fmt: skip
"""Gestures that take the legs too, or the head alone."""
_SIGNS = (GESTURE_WORDS.keys() - _WHOLE) | {
    "clap", "shrug", "point", "salute", "pray", "eat", "drink", "phone", "cook",
}  # fmt: skip
_GESTURING = ("arms", "head", "arms and head")
_LIMB = re.compile(r"\b(?:hands?|arms?|fists?)\b", re.IGNORECASE)
_JOINTS = tuple(
    re.compile(joint, re.IGNORECASE)
    for joint in (r"\s*,?\s+(?:while|whilst)\s+", r"\s*,?\s+and\s+(?!then\b)", r"\s*,\s*(?=\w+ing\b)")
)


def split_voices(clause: str) -> tuple[str, ...]:
    """What a clause says of the legs and what of the arms or the head, said as clauses of their own; none where it does
    not say both.

    Args:
        clause: In English.
    """
    text = " ".join(clause.split())
    for joint in _JOINTS:
        halves = [half.strip(" ,.;!") for half in joint.split(text)]
        if len(halves) != 2 or not all(halves):
            continue
        first, second = halves[0], with_subject(halves[1], subject_of(halves[0])[0])
        parts = [moved_part(half) for half in (first, second)]
        if "legs" in parts and any(part in _GESTURING for part in parts):
            return (first, second) if parts[0] == "legs" else (second, first)
    return ()


def moved_part(clause: str) -> str:
    """What its verb moves: "legs", "arms", "head", "arms and head", or "" for neither or all."""
    words = subject_of(clause)[1].lower().split()
    words = words[1:] if words and words[0] in ("is", "are") else words
    while words and words[0].endswith("ly"):
        words = words[1:]
    verb = words[0] if words else ""
    for part, verbs in (("legs", _LEGS), ("arms", _ARMS), ("head", _HEAD)):
        if any(
            verb in (plain, conjugate(f"{{{plain}}}", "third"), conjugate(f"{{{plain}}}", "gerund")) for plain in verbs
        ):
            return part
    if verb in (
        "raise",
        "raises",
        "raising",
        "lift",
        "lifts",
        "lifting",
        "swing",
        "swings",
        "swinging",
    ) and _LIMB.search(clause):
        return "arms"
    said = set(actions_of(clause))
    if said and said <= _SIGNS:
        return "arms and head"
    return "head" if said and said <= {"shake head", "look around"} else ""
