"""Clips joined into one: where to leave one motion for another, the cross-fade, and the sentence in the right order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.geometry.easing import smooth_step
from bunraku.language.grammar import conjugate, is_stative

__all__ = ["join_point", "link", "splice"]

_BLEND = 6
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


def join_point(
    tail: np.ndarray,
    head: np.ndarray,
    weights: np.ndarray,
    blend: int = _BLEND,
    most: tuple[int | None, int | None] = (None, None),
) -> tuple[int, int, float]:
    """Where to leave one motion and enter another so that pose and velocity agree best.

    Args:
        tail: Motion to leave in its last quarter, shape (N, D), network units.
        head: Motion to enter in its first quarter, shape (M, D).
        weights: Share of each feature, shape (D,).
        blend: Frames that both must still have after that.
        most: Frames at the most, beside the blend, that are lost of the tail's end and of the head's beginning; None
            for a quarter.

    Returns:
        Frame i of the tail, frame j of the head, and the mean squared difference there.
    """
    last = max(len(tail) - blend + 1, 1)
    first = min(3 * len(tail) // 4, last - 1) if most[0] is None else max(last - 1 - most[0], 0)
    stop = max(1, min(len(head) // 4 if most[1] is None else most[1] + 1, len(head) - blend))
    scale = np.sqrt(weights / weights.sum())
    a, b = tail[first:last] * scale, head[:stop] * scale
    distance = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return first + int(i), int(j), float(max(distance[i, j], 0))


def splice(tail: np.ndarray, head: np.ndarray, i: int, j: int, blend: int = _BLEND) -> np.ndarray:
    """`tail` up to frame i, then `head` from frame j, cross-faded over the next `blend` frames of both."""
    blend = min(blend, len(tail) - i, len(head) - j)
    share = smooth_step(np.linspace(0, 1, blend + 2, dtype=np.float32)[1:-1, None])
    mixed = tail[i : i + blend] * (1 - share) + head[j : j + blend] * share
    return np.concatenate([tail[:i], mixed, head[j + blend :]])


def link(phrases: Sequence[str], random: np.random.Generator, subjects: Sequence[str] = _SUBJECTS) -> str:
    """One sentence for two or three phrases that follow each other in time.

    Args:
        phrases: With their verbs in braces, as `grammar` has them.
        random: Chooses the form and the subject.
        subjects: To choose from.
    """
    frames: tuple[str, ...] = _TWO if len(phrases) == 2 else _THREE
    stative = [str(place + 1) for place, phrase in enumerate(phrases) if is_stative(phrase)]
    frames = tuple(frame for frame in frames if not any(f"{{{place}g}}" in frame for place in stative))
    words = {
        f"{place + 1}{form[0]}": conjugate(phrase, form)
        for place, phrase in enumerate(phrases)
        for form in ("plain", "third", "gerund")
    }
    sentence = frames[int(random.integers(len(frames)))].replace("{s}", subjects[int(random.integers(len(subjects)))])
    for key, text in words.items():
        sentence = sentence.replace(f"{{{key}}}", text)
    return sentence
