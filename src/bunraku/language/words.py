"""Japanese, Chinese, German, French and Spanish read through a table of words, as plain English.

The text encoder knows English alone. A sentence in one of the five is put together again from the words of
`words.json`. What the table does not have is read by a small network where that is sure (`foreign.tagger`), and is
otherwise left out, and said.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass

from bunraku.language.foreign.sentence import english_sentence
from bunraku.language.foreign.table import LANGUAGES, Concept
from bunraku.language.known.vocabulary import words_of

__all__ = ["Translation", "translate"]

_MOST, _SOME = 0.4, 0.3
"""Of a sentence's words the share that a language's table must have, with a verb among them and without."""


@dataclass(frozen=True)
class Translation:
    """A sentence in English.

    Args:
        english: "a person walks forward, then waves with the left hand"; the sentence itself where it is English or in
            no language of the table, and "" where it is in one and the table has no word of it.
        language: "en", "de", "fr", "es", "ja" or "zh"; "" for another script.
        concepts: Words of the table in their order, those that neither it nor the tagger has as "unknown"; none of
            English.
    """

    english: str
    language: str
    concepts: tuple[Concept, ...] = ()

    @property
    def unknown(self) -> tuple[str, ...]:
        """Words that are not read."""
        return tuple(concept.value for concept in self.concepts if concept.kind == "unknown")


def translate(prompt: str) -> Translation:
    """A sentence in English, as the captions of training say it, with order, sides and numbers kept.

    Args:
        prompt: In English or a language of the table, which is told by its script and by the words that the table has.
    """
    from bunraku.language.foreign.unspaced import scan_unspaced

    scripts = set() if prompt.isascii() else {_script(letter) for letter in prompt if letter.isalpha()}
    if "kana" in scripts:
        return _translated(prompt, "ja", scan_unspaced(prompt, "ja"))
    if "han" in scripts:
        chinese, japanese = scan_unspaced(prompt, "zh"), scan_unspaced(prompt, "ja")
        if _missing(japanese) < _missing(chinese):
            return _translated(prompt, "ja", japanese)
        return _translated(prompt, "zh", chinese)
    if scripts and "latin" not in scripts:
        return Translation(prompt, "")
    words = words_of(prompt)
    english = sum(word.known for word in words) / len(words) if words else 1.0
    if english < 1:
        from bunraku.language.foreign.spaced import scan_spaced

        shares = []
        for other in ("de", "fr", "es"):
            concepts = scan_spaced(prompt, other)
            counted = [concept for concept in concepts if concept.kind not in ("comma", "stop", "number")]
            share = 1 - sum(concept.kind == "unknown" for concept in counted) / len(counted) if counted else 0.0
            says = any(concept.kind in ("verb", "unit") for concept in counted)
            if share > max(english, _MOST if says else _SOME):
                shares.append((says, share, other, concepts))
        if shares:
            says, _, language, concepts = max(shares, key=lambda found: found[:2])
            found = _translated(prompt, language, concepts)
            if says or any(concept.kind == "verb" for concept in found.concepts):
                return found
    return Translation(prompt, "en")


def _translated(prompt: str, language: str, concepts: list[Concept]) -> Translation:
    assert language in LANGUAGES
    if any(concept.kind == "unknown" for concept in concepts):
        from bunraku.language.foreign.tagger import tagged  # numpy, which English needs not

        concepts = tagged(prompt, language, concepts)
    return Translation(english_sentence(concepts, language), language, tuple(concepts))


def _missing(concepts: list[Concept]) -> int:
    return sum(concept.stop - concept.start for concept in concepts if concept.kind == "unknown")


def _script(letter: str) -> str:
    name = unicodedata.name(letter, "")
    if name.startswith(("HIRAGANA", "KATAKANA")):
        return "kana"
    if name.startswith("CJK UNIFIED"):
        return "han"
    return "latin" if "LATIN" in name else "other"
