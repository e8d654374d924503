"""The known sentences that are nearest to one that is not understood."""

from __future__ import annotations

import functools
import math
import re
from collections import Counter
from collections.abc import Sequence

from bunraku.language.captions.grammar import conjugate
from bunraku.language.captions.phrases import known_phrases
from bunraku.language.known.spelling import slips
from bunraku.language.known.vocabulary import FUNCTION_WORDS, stem

__all__ = ["nearest_sentences"]

_LONGEST = 8
"""Words of a phrase that is shown to somebody who looks for one."""
_MOST = 4
"""Unknown words that are looked up; each takes half a millisecond."""
_SHORT, _LIKE = 5, (0.7, 0.5)
"""Letters of a short word, and the share that it, or a longer one, must have in common with a known word to be like
it.
"""
_DOING = ("do", "make", "take", "give")
_WORD = re.compile(r"[a-z]+(?:['-][a-z]+)*")


@functools.cache
def _phrases() -> tuple[tuple[str, str, frozenset[str]], ...]:
    """Each short caption as a sentence, its verb, and the stems of its words that say something."""
    found = []
    for phrase in known_phrases():
        plain = conjugate(phrase, "plain")
        words = _WORD.findall(plain)
        verb = re.match(r"\{(\w+)\}", phrase)
        if verb and len(words) <= _LONGEST and not phrase.startswith("{be}"):
            stems = frozenset(stem(word) for word in words if word not in FUNCTION_WORDS)
            found.append((f"a person {conjugate(phrase, 'third')}", verb.group(1), stems))
    return tuple(found)


@functools.cache
def _index() -> tuple[dict[str, tuple[int, ...]], dict[str, float], dict[str, list[str]]]:
    """Phrases by stem, the weight of each stem (rare ones say more), and stems by the pairs of letters in them."""
    indices: dict[str, list[int]] = {}
    for index, (_, _, stems) in enumerate(_phrases()):
        for one in stems:
            indices.setdefault(one, []).append(index)
    weights = {one: math.log(1 + len(_phrases()) / len(where)) for one, where in indices.items()}
    looks: dict[str, list[str]] = {}
    for one in indices:
        for pair in _pairs(one):
            looks.setdefault(pair, []).append(one)
    return {one: tuple(where) for one, where in indices.items()}, weights, looks


def _pairs(word: str) -> frozenset[str]:
    padded = f" {word} "
    return frozenset(padded[index : index + 2] for index in range(len(padded) - 1))


def _alike(word: str, most: int = 6) -> list[tuple[str, float]]:
    """Stems that look like a word, and how much: by pairs of letters first, the best of them by their slips."""
    own, looks = _pairs(word), _index()[2]
    common = Counter(one for pair in own for one in looks.get(pair, ()))
    first = sorted(common, key=lambda one: (-common[one] / (len(own) + len(one)), one))[:most]
    return [(one, max(0.0, 1 - slips(word, one, 9) / max(len(word), len(one)))) for one in first]


def nearest_sentences(words: Sequence[str], unknown: Sequence[str] = (), count: int = 3) -> tuple[str, ...]:
    """Captions that share stems with a sentence, or have words that look like those that are not known.

    Args:
        words: The sentence's known words.
        unknown: Its other words.
        count: How many, each with a verb of its own.
    """
    where, weights, _ = _index()
    scores: Counter[int] = Counter()
    wanted = {stem(word): 1.0 for word in words if word.lower() not in FUNCTION_WORDS}
    for word in unknown[:_MOST]:
        for one, share in _alike(stem(word)):
            if share < _LIKE[len(word) > _SHORT]:
                continue
            wanted[one] = max(wanted.get(one, 0.0), 0.5 * share)
    for one, share in wanted.items():
        for index in where.get(one, ()):
            scores[index] += share * weights[one]  # type: ignore[assignment]
    phrases = _phrases()
    usual = Counter(verb for _, verb, _ in phrases if verb not in _DOING)  # where nothing is near: what is done most

    def rank(index: int) -> tuple[float, int, int, int]:
        _, verb, stems = phrases[index]
        return -scores[index] / (2 + len(stems)), -usual[verb], len(stems), index

    order = sorted(range(len(phrases)), key=rank)
    found: dict[str, str] = {}
    for index in order:
        sentence, verb, _ = phrases[index]
        if verb not in found:
            found[verb] = sentence
        if len(found) == count:
            break
    return tuple(found.values())
