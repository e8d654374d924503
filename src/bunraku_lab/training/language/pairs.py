"""Pairs of sentences, English and another language, and what the English says is done.

The files are those of manythings.org/anki: a pair a line, parted by a tab, from Tatoeba (CC BY 2.0 FR). What is held
out is decided by the English sentence alone, so that no translation of it is trained on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from bunraku.errors import FormatError
from bunraku.language.lexicon.reading import actions_of
from bunraku.language.prompts import narrow

__all__ = ["FILES", "Pair", "lot", "read_pairs", "split_of"]

FILES = {"de": "deu.txt", "fr": "fra.txt", "es": "spa.txt", "ja": "jpn.txt", "zh": "cmn.txt"}
"""The file of each language."""
_LONGEST = 16
"""Words of an English sentence that is taken."""


@dataclass(frozen=True)
class Pair:
    """A sentence in two languages.

    Args:
        english: In English.
        other: In the other language.
        language: "de", "fr", "es", "ja" or "zh".
        actions: What the rules find in the English.
    """

    english: str
    other: str
    language: str
    actions: tuple[str, ...] = ()


def lot(sentence: str, draw: str = "split") -> float:
    """A number from 0 to 1 that a sentence draws, always the same in a draw of this name."""
    return int.from_bytes(hashlib.sha256(f"31 {draw} {sentence}".encode()).digest()[:6], "big") / 2**48


def split_of(english: str) -> str:
    """ "held" for a tenth of the English sentences, "val" for a twentieth, "train" for the others."""
    number = lot(english)
    return "held" if number < 0.1 else "val" if number < 0.15 else "train"


def read_pairs(folder: Path, splits: Iterable[str] = ("train",)) -> list[Pair]:
    """The pairs of some splits, each once.

    Args:
        folder: With the five files.
        splits: Of "train", "val" and "held".

    Raises:
        FormatError: A file is missing, or a line of it is no pair.
    """
    wanted, found = frozenset(splits), []
    known: dict[str, tuple[str, ...]] = {}
    for language, name in FILES.items():
        path = folder / name
        if not path.is_file():
            raise FormatError(
                path, "this file of pairs is missing; give a folder that has it: English, a tab, the other language"
            )
        seen = set()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            parts = line.split("\t")
            if len(parts) < 2:
                raise FormatError(path, f"line {number} is no pair; it must be English, a tab, the other language")
            english, other = parts[0].strip(), narrow(parts[1].strip())
            if not english or not other or split_of(english) not in wanted or (english, other) in seen:
                continue
            if '"' in english or len(english.split()) > _LONGEST:
                continue
            seen.add((english, other))
            if english not in known:
                known[english] = actions_of(english)
            found.append(Pair(english, other, language, known[english]))
    return found
