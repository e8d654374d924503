"""A text as its words."""

from __future__ import annotations

import re

__all__ = ["words_of"]

_WORD = re.compile(r"[^\W_]+|[^\w\s'’-]")


def words_of(text: str) -> tuple[list[str], list[tuple[int, int]]]:
    """The words of a text in small letters and where each stands; a sign of punctuation is a word, and hyphens and
    apostrophes part words.
    """
    words: list[str] = []
    places: list[tuple[int, int]] = []
    for found in _WORD.finditer(text):
        words.append(found.group().lower())
        places.append(found.span())
    return words, places
