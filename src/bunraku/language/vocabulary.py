"""Known words: those of the training sentences and of a user's own clips, and corrected spelling."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from bunraku.core.files import atomic_write, read_bounded, weights_file
from bunraku.errors import WeightsError
from bunraku.language.captions import caption_table, creature_words, known_phrases
from bunraku.language.lexicon import actions_of, lexicon
from bunraku.language.tokenizer import word_pieces

FILE = "own_words.json"
"""Its name, in a folder of weights."""
_MOST_OWN_WORDS = 100_000


@functools.cache
def own_words() -> frozenset[str]:
    """The words of the first folder of weights that has such a file; none where there is none.

    Raises:
        WeightsError: The file is no list of words.
    """
    path = weights_file(FILE)
    if not path.is_file():
        return frozenset()
    try:
        words = json.loads(read_bounded(path))
    except ValueError:
        words = None
    if not isinstance(words, list) or len(words) > _MOST_OWN_WORDS or not all(isinstance(one, str) for one in words):
        raise WeightsError(f"{path}: this is not a list of words; write it again with: bunraku data examples --add-to")
    return frozenset(word.lower() for word in words)


def write_own_words(folder: Path, words: Iterable[str]) -> Path:
    """Write words into a folder of weights.

    Raises:
        FormatError: It cannot be written.
    """
    path = folder / FILE
    with atomic_write(path) as file:
        file.write((json.dumps(sorted({word.lower() for word in words}), ensure_ascii=False) + "\n").encode())
    return path


_WORD = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*")
FUNCTION_WORDS = lexicon().grammar["function"]
"""Words that say nothing of a movement; they are in every language model, and no reason for a warning."""


class Word(NamedTuple):
    """A word of a sentence: as it stands there, from where to where, and whether training had it."""

    text: str
    start: int
    stop: int
    known: bool


@functools.lru_cache(maxsize=16384)
def stem(word: str) -> str:
    """What an English word has in common with its inflections: "waving", "waves" and "waved" are "wav"."""
    return stems((word,))[0]


def stems(words: Iterable[str]) -> list[str]:
    """The stem of each of some words."""
    stems, irregular = [], lexicon().irregular
    for word in words:
        word = word.lower().replace("’", "'").removesuffix("'s").rstrip("'")
        word = irregular.get(word, word)
        if word.endswith("ly") and len(word) > 4:
            word = word[:-2]
        for ending, least in (("ies", 2), ("ied", 2), ("es", 3), ("s", 3), ("ing", 3), ("ed", 3)):
            if word.endswith(ending) and len(word) - len(ending) >= least and not word.endswith("ss"):
                word = word[: -len(ending)] + ("y" if ending in ("ies", "ied") else "")
                break
        if len(word) > 2 and word[-1] == "e":
            word = word[:-1]
        if len(word) > 2 and word[-1] == word[-2] and word[-1] not in "aeiou":
            word = word[:-1]
        stems.append(word[:-1] + "i" if len(word) > 2 and word[-1] == "y" else word)
    return stems


@functools.cache
def known_words() -> dict[str, int]:
    """The words as they are written, with how many sentences have each; 1 for those of the tables, with names of
    characters and of parts of the body.
    """
    written: dict[str, int] = caption_table("vocabulary.json")["words"]
    named = [
        row["en"].replace("/", " ") for section in ("beings", "parts") for row in caption_table("words.json")[section]
    ]
    lexical = (*lexicon().words, *lexicon().verbs, *lexicon().grammar["other words"], *lexicon().grammar["things"])
    listed = " ".join((*known_phrases(), *creature_words(), *named, *lexical))
    return (
        dict.fromkeys(own_words(), 1)
        | dict.fromkeys(re.findall(r"[a-z]+", listed.lower()), 1)
        | dict.fromkeys(FUNCTION_WORDS, 1)
        | written
    )


@functools.cache
def _stems() -> frozenset[str]:
    return frozenset(stems(known_words()))


@functools.cache
def caption_stems() -> frozenset[str]:
    """Stems of the words that watched captions share."""
    return frozenset(stems(caption_table("vocabulary.json")["words"]))


@functools.cache
def action_stems() -> frozenset[str]:
    """Stems of the verbs that training shows, without those that say no movement by themselves, and without those that
    are a part of the body, too.
    """
    verbs = {*lexicon().verbs, *caption_table("vocabulary.json")["verbs"], *own_words()}
    parts = [name for row in caption_table("words.json")["parts"] for name in row["en"].split("/")]
    return (frozenset(stems(verbs)) & _stems()) - frozenset(stems([*parts, *lexicon().grammar["light verbs"]]))


def is_known(word: str) -> bool:
    """Whether training had a word, in any inflection; of one with hyphens whether it had all parts."""
    plain = word.lower()
    written = caption_table("vocabulary.json")["words"]
    if plain in FUNCTION_WORDS or plain in lexicon().lemmas or plain in lexicon().words or plain in written:
        return True
    table = _stems()
    if stem(word) in table or word.isdigit():
        return True
    parts = re.split(r"[-'’]", word)
    return len(parts) > 1 and all(not part or part.isdigit() or stem(part) in table or len(part) < 2 for part in parts)


def words_of(sentence: str) -> list[Word]:
    """The words of a sentence with their places."""
    return [Word(match.group(), *match.span(), is_known(match.group())) for match in _WORD.finditer(sentence)]


def says_action(sentence: str) -> bool:
    """Whether any word of a sentence is a movement that training shows."""
    if actions_of(sentence):
        return True
    acting = action_stems()
    return any(
        stem(part) in acting
        for word in _WORD.findall(sentence)
        for part in (word, *re.split(r"[-'’]", word))
        if part.lower() not in FUNCTION_WORDS
    )


_OFTEN, _LONG = 5, 8
"""Sentences that must have a word for it to be meant by another one, unless it is long, and the letters without an
ending from which on two slips are forgiven ("juggling" is no "jogging"); chosen by eye.
"""


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
    by_stem: dict[str, list[str]] = {}
    for word, count in sorted(known_words().items(), key=lambda item: (-item[1], item[0])):
        if len(word) >= 4 and (count >= _OFTEN or len(word) > _LONG or word in FUNCTION_WORDS):
            by_stem.setdefault(word[0], []).append(word)
    return by_stem


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
    corrections = [
        (slips(plain, other, most), index, other)
        for index, other in enumerate(near)
        if len(letters.symmetric_difference(other)) <= 2 * most
    ]
    best = min((item for item in corrections if item[0] <= most and _likely(plain, item[2])), default=None)
    return best[2] if best else ""


def _likely(word: str, other: str) -> bool:
    """Whether a letter too many in a short word is doubled: "wallks" is "walks", but "chomp" is no "chop"."""
    if len(word) != len(other) + 1 or len(word) >= _LONG:
        return True
    twice = [index for index in range(len(other)) if word[index] == word[index + 1]]
    return any(word[:index] + word[index + 1 :] == other for index in twice)
