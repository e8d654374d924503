"""Typing errors: a word that is one slip away from a known one, two slips where it is long."""

from __future__ import annotations

import functools

from bunraku.language.known.tokenizer import word_pieces
from bunraku.language.known.vocabulary import FUNCTION_WORDS, known_words, stem

__all__ = ["corrected", "slips"]

_OFTEN = 5
"""Sentences that must have a word for it to be meant by another one, unless it is long."""
_LONG = 8
"""Letters without an ending from which on two slips are forgiven: "juggling" is no "jogging"."""


def slips(one: str, other: str, most: int = 2) -> int:
    """How many letters must be put in, left out, changed, or swapped with their neighbour to make one word the other
    (the restricted distance of Damerau 1964); `most` + 1 where it is more than that.
    """
    if abs(len(one) - len(other)) > most:
        return most + 1
    before, row = [0] * (len(other) + 1), list(range(len(other) + 1))
    for i, letter in enumerate(one, 1):
        older, before, row = before, row, [i] + [0] * len(other)
        for j, target in enumerate(other, 1):
            row[j] = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != target))
            if i > 1 and j > 1 and letter == other[j - 2] and one[i - 2] == target:
                row[j] = min(row[j], older[j - 2] + 1)
        if min(row) > most:
            return most + 1
    return min(row[-1], most + 1)


@functools.cache
def _often() -> dict[str, list[str]]:
    """Words that may be meant, by their first letter, the most frequent first."""
    found: dict[str, list[str]] = {}
    for word, count in sorted(known_words().items(), key=lambda item: -item[1]):
        if len(word) >= 4 and (count >= _OFTEN or len(word) > _LONG or word in FUNCTION_WORDS):
            found.setdefault(word[0], []).append(word)
    return found


@functools.lru_cache(maxsize=1024)
def corrected(word: str) -> str:
    """The known word that is meant; "" where none is near, or the word is a rightly spelled one.

    One slip is forgiven from four letters on, two from eight, never in the first letter but by a swap.
    """
    plain = word.lower()
    if len(plain) < 4 or not plain.isascii() or not plain.isalpha() or plain in word_pieces():
        return ""
    most = 2 if len(stem(plain)) >= _LONG else 1
    near = [*_often().get(plain[0], ()), *(other for other in _often().get(plain[1], ()) if other[1] == plain[0])]
    letters = set(plain)
    found = [
        (slips(plain, other, most), index, other)
        for index, other in enumerate(near)
        if len(letters.symmetric_difference(other)) <= 2 * most
    ]
    best = min((item for item in found if item[0] <= most and _likely(plain, item[2])), default=None)
    return best[2] if best else ""


def _likely(word: str, other: str) -> bool:
    """Whether a letter too many, where the word is not long, stands there twice: "wallks" is "walks", but "chomp" is no
    "chop".
    """
    if len(word) != len(other) + 1 or len(word) >= _LONG:
        return True
    twice = [index for index in range(len(other)) if word[index] == word[index + 1]]
    return any(word[:index] + word[index + 1 :] == other for index in twice)
