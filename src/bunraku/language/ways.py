"""Ways of moving that only some bodies have: to fly, to swim, to crawl and to slither."""

from __future__ import annotations

import re

from bunraku.language.clauses import subject_of

__all__ = ["WAYS", "said_otherwise", "way_of"]

WAYS: dict[str, str] = {
    "fly": r"fl(?:y|ies|ying)|hover(?:s|ing)?|soar(?:s|ing)?|flap(?:s|ping)?",
    "swim": r"swim(?:s|ming)?",
    "slither": r"slither(?:s|ing)?",
    "crawl": r"crawl(?:s|ing)?|scuttl(?:es?|ing)|scurr(?:y|ies|ying)",
    "walk": r"walk(?:s|ing)?|stroll(?:s|ing)?|march(?:es|ing)?|step(?:s|ping)?",
    "run": r"run(?:s|ning)?|jog(?:s|ging)?|sprint(?:s|ing)?|gallop(?:s|ing)?|trot(?:s|ting)?",
}
"""Verbs of each way; the first that a clause says counts."""
_WORDS = {way: re.compile(rf"\b(?:{words})\b", re.IGNORECASE) for way, words in WAYS.items()}


def way_of(clause: str) -> str:
    """The way of moving that a clause says, "" for none of `WAYS`."""
    rest = subject_of(clause)[1]
    found = {way: match.start() for way, pattern in _WORDS.items() if (match := pattern.search(rest))}
    return min(found, key=lambda way: found[way]) if found else ""


def said_otherwise(clause: str, verb: str) -> str:
    """A clause with its verb of moving replaced: "it crawls ahead" becomes "it walks ahead".

    Args:
        clause: Of a way of moving.
        verb: In the third person.
    """
    way = way_of(clause)
    if not way:
        return clause
    rest = subject_of(clause)[1]
    head = clause[: len(clause) - len(rest)]
    if re.match(r"\s*is\s", rest):  # "is crawling" and "crawls" are one
        rest = re.sub(r"^\s*is\s+", "", rest)
    return head + _WORDS[way].sub(verb, rest, count=1)
