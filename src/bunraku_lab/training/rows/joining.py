"""One sentence for clips that are joined into one, in the right order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.language.captions.grammar import conjugate, is_stative

__all__ = ["link"]

_SUBJECTS = ("a person", "someone", "the character", "a human", "the person", "a man", "a woman", "he", "she")
# {1t} is the first clause in the third person, {2g} the second as a gerund, {1p} plain; {s} the subject
_TWO = (
    "{s} {1t} and then {2t}", "{s} {1t}, then {2t}", "{s} {1t} and {2t}", "{s} {1t}, and then {2t}",
    "first {s} {1t}, then {2t}",
    "{1p}, then {2p}", "{1p} and then {2p}", "first {1p}, then {2p}", "{1t}, then {2t}",
    "{s} {1t}, and after that {2t}",
    "{s} {1t} before {2g}", "{s} {1t}, followed by {2g}", "after {1g}, {s} {2t}", "{s} {2t} after {1g}",
    "{s} is {1g}, then {2g}",
    "{s} starts by {1g} and then {2t}", "{s} {1t}, afterwards {2t}", "{s} {1t} and finally {2t}",
)  # fmt: skip
_THREE = (
    "{s} {1t}, {2t} and then {3t}", "{s} {1t}, then {2t}, then {3t}", "{s} {1t}, then {2t} and {3t}",
    "first {s} {1t}, then {2t} and finally {3t}",
    "{1p}, then {2p}, then {3p}", "{1t}, {2t}, then {3t}", "{s} {1t} and then {2t} before {3g}",
    "after {1g}, {s} {2t} and then {3t}",
    "{s} starts by {1g}, then {2t}, and finally {3t}",
)  # fmt: skip


def link(phrases: Sequence[str], random: np.random.Generator, subjects: Sequence[str] = _SUBJECTS) -> str:
    """One sentence for two or three phrases that follow each other in time.

    Args:
        phrases: With their verbs in braces, as `grammar` has them.
        random: Chooses the form and the subject.
        subjects: To choose from.
    """
    frames: tuple[str, ...] = _TWO if len(phrases) == 2 else _THREE
    stative = [str(index + 1) for index, phrase in enumerate(phrases) if is_stative(phrase)]
    frames = tuple(frame for frame in frames if not any(f"{{{index}g}}" in frame for index in stative))
    words = {
        f"{index + 1}{form[0]}": conjugate(phrase, form)
        for index, phrase in enumerate(phrases)
        for form in ("plain", "third", "gerund")
    }
    sentence = frames[int(random.integers(len(frames)))].replace("{s}", subjects[int(random.integers(len(subjects)))])
    for key, text in words.items():
        sentence = sentence.replace(f"{{{key}}}", text)
    return sentence
