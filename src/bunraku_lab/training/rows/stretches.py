"""Sentences for a stretch that was watched: as written, about other subjects, and from its tersest form."""

from __future__ import annotations

import functools
import re
import zlib
from collections.abc import Sequence

from bunraku.language.captions.grammar import sentence_forms
from bunraku.language.captions.phrases import caption_clauses, caption_variants, mirror_words
from bunraku.language.lexicon.tables import lexicon

__all__ = ["agreeing", "stretch_phrases", "stretch_variants"]

_SUBJECT = re.compile(
    r"^(?:a|the|one) (?:person|human|man|woman|figure|character)\b|^someone\b|^somebody\b", re.IGNORECASE
)
_SUBJECTS = (
    "a person",
    "someone",
    "the character",
    "a man",
    "a woman",
    "the person",
    "he",
    "she",
    "a figure",
    "a human",
    "somebody",
    "this person",
)
_LINK = re.compile(r"(,? and then |,? then |,? and |, )")


@functools.lru_cache(maxsize=8192)
def stretch_phrases(texts: tuple[str, ...]) -> tuple[str, ...]:
    """The tersest sentence with its verbs in braces, "{walk} fast, {turn} left"; none where it does not begin with a
    verb: "brisk walk".

    Args:
        texts: Sentences of a stretch, the tersest last.
    """
    parts = _LINK.split(texts[-1])
    braced = []
    for index, part in enumerate(parts):
        first, *rest = part.split(" ", 1)
        if index % 2 == 0 and first.lower() in lexicon().verbs:
            part = " ".join(["{" + first.lower() + "}", *rest])
        elif index == 0:
            return ()
        braced.append(part)
    return ("".join(braced),)


@functools.lru_cache(maxsize=8192)
def stretch_variants(texts: tuple[str, ...], labels: tuple[str, ...] = (), mirrored: bool = False) -> tuple[str, ...]:
    """All sentences for a stretch: as written, the full ones with another subject, and the tersest in a few forms.

    Args:
        texts: Its sentences, the tersest last.
        labels: Sentences from labels that say the same (`agreeing`).
        mirrored: For the mirror image.
    """
    found = list(texts)
    for text in texts:
        subject = _SUBJECT.match(text)
        if subject:
            other = _SUBJECTS[zlib.crc32(text.encode()) % len(_SUBJECTS)]
            found.append(other + text[subject.end() :])
    for phrase in stretch_phrases(texts):
        forms = sentence_forms(phrase)
        found += [forms[0], *(forms[(zlib.crc32(phrase.encode()) + step) % len(forms)] for step in range(2))]
    found += labels
    return tuple(dict.fromkeys(map(mirror_words, found) if mirrored else found))


@functools.lru_cache(maxsize=8192)
def agreeing(texts: tuple[str, ...], labels: tuple[str, ...], most: int = 4) -> tuple[str, ...]:
    """Sentences of labels whose verbs the watched sentences have too, and whose sides and directions they do not deny.

    Args:
        texts: Sentences of a stretch.
        labels: Labels of its clip.
        most: How many to give at the most, drawn by their spelling.
    """
    seen = " ".join(texts).lower()
    found: list[str] = []
    for label in labels:
        phrases = caption_clauses(label, form="braces")
        good = [phrase for phrase in phrases if _agrees(phrase, seen)]
        if good:
            sentences = caption_variants(label)
            first = zlib.crc32(label.encode())
            found += [sentences[(first + 7 * step) % len(sentences)] for step in range(most)]
    kept = [sentence for sentence in dict.fromkeys(found) if _sides(sentence) <= _sides(seen)]
    return tuple(kept[:most])


_BRACED = re.compile(r"\{(\w+)\}")


def _agrees(phrase: str, seen: str) -> bool:
    return all(re.search(rf"\b{verb[: max(len(verb) - 1, 3)]}", seen) for verb in _BRACED.findall(phrase))


def _sides(sentence: str) -> set[str]:
    words = ("left", "right", "backward", "sideways", "around", "twice", "circle", "clockwise")
    return {word for word in words if word in sentence.lower()}


def joined_sentence(sentences: Sequence[str]) -> str:
    """Full sentences about one person as one, in order: "a person sits down, then gets up and walks off"."""
    first, *rest = sentences
    return first + "".join(f", then {_SUBJECT.sub('', text).strip()}" for text in rest)


def goes_on(text: str) -> bool:
    """Whether a sentence has a subject that the next one can do without."""
    return bool(_SUBJECT.match(text))
