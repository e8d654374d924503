"""What happens at the same time in a sentence: "walks while waving" is walking, and arms that wave.

Hardly any capture shows a gesture of the arms or the head on the way, so the network does one of both. Where a sentence
joins a movement of the legs and one of the arms or the head, two motions are denoised side by side. The first is
conditioned on the legs' words, the second on the gesture's; at each step the second is given all but the gesture's
handles by the first, as an edit that keeps them is (section A.3 of TapMo).
"""

from __future__ import annotations

import re

from bunraku.language.clauses import subject_of, with_subject
from bunraku.language.handling import handling_of
from bunraku.language.lexicon.reading import actions_of, words_of
from bunraku.language.lexicon.tables import lexicon

__all__ = ["moved_part", "split_voices"]

_GESTURING = ("arms", "head", "arms and head")
_JOINTS = tuple(
    re.compile(joint, re.IGNORECASE)
    for joint in (r"\s*,?\s+(?:while|whilst)\s+", r"\s*,?\s+and\s+(?!(?:then|forth)\b)", r"\s*,\s*(?=\w+ing\b)")
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
    words = words_of(subject_of(clause)[1])[0]
    words = words[1:] if words and words[0] in ("is", "are") else words
    while words and words[0].endswith("ly") and len(words[0]) > 3:
        words = words[1:]
    table = lexicon()
    verb = words[0] if words else ""
    part = table.parts.get(verb, "")
    if part in ("legs", "arms", "head"):
        return part
    held = handling_of(clause)
    if held is not None and held.said and held.only_held:
        return "arms"  # a thing that is carried as captured people carry it is no gesture
    said = {table.actions[action].part for action in actions_of(clause)}
    if said == {"legs"}:
        return "legs"  # "does a lunge", whose verb says nothing of it
    if not said or not said <= set(_GESTURING):
        return ""
    return said.pop() if len(said) == 1 else "arms and head"
