"""Sentences as numbers of word pieces, as BERT's uncased tokenizer gives them (Devlin et al. 2019; Wu et al. 2016).

The package `tokenizers` does the same and brings a client for model hubs and 40 MB with it; a test holds the two
together. Its words and the encoder's config travel in the header of the weights.
"""

from __future__ import annotations

import functools
import json
import re
import unicodedata
from functools import lru_cache
from pathlib import Path

from bunraku.core.files import PACKAGE_WEIGHTS, weights_file
from bunraku.errors import WeightsError

FIRST, LAST, UNKNOWN = "[CLS]", "[SEP]", "[UNK]"
LONGEST_WORD = 100
_IDEOGRAPHS = (
    (0x4E00, 0x9FFF), (0x3400, 0x4DBF), (0x20000, 0x2A6DF), (0x2A700, 0x2B73F), (0x2B740, 0x2B81F), (0x2B920, 0x2CEAF),
    (0xF900, 0xFAFF), (0x2F800, 0x2FA1F),
)  # fmt: skip
"""Of Chinese, each a word; the sixth range begins as that of the published tokenizer does."""


class WordPieces:
    """The tokenizer of a `tokenizer.json` of this kind.

    Args:
        text: The file.

    Raises:
        ValueError: It is not JSON, or a tokenizer of another kind.
    """

    def __init__(self, text: str):
        settings = json.loads(text)
        model, normal = settings["model"], settings["normalizer"]
        if model["type"] != "WordPiece" or normal["type"] != "BertNormalizer" or not normal["lowercase"]:
            raise ValueError("its tokenizer is another")
        self._pieces: dict[str, int] = model["vocab"]
        special = [token["content"] for token in settings["added_tokens"]]
        self._special = re.compile("(" + "|".join(map(re.escape, special)) + ")")

    def __len__(self) -> int:
        return len(self._pieces)

    def numbers(self, sentence: str, most: int) -> list[int]:
        """The numbers of a sentence, the marks of its beginning and end among them; the end of one of more than `most`
        is left out.
        """
        numbers: list[int] = []
        for part in self._special.split(sentence):
            if self._special.fullmatch(part):
                numbers.append(self._pieces[part])
                continue
            for word in _words(part):
                numbers += self._of_word(word)
            if len(numbers) > most:
                break
        return [self._pieces[FIRST], *numbers[: most - 2], self._pieces[LAST]]

    def _of_word(self, word: str) -> list[int]:
        """The longest piece that a word begins with, then that of the rest, and so on."""
        if len(word) > LONGEST_WORD:
            return [self._pieces[UNKNOWN]]
        pieces, start = [], 0
        while start < len(word):
            stop, mark = len(word), "##" if start else ""
            while stop > start and (piece := self._pieces.get(mark + word[start:stop])) is None:
                stop -= 1
            if piece is None:
                return [self._pieces[UNKNOWN]]
            pieces.append(piece)
            start = stop
        return pieces


def _words(text: str) -> list[str]:
    """Words in small letters without accents, and signs, each by itself."""
    plain = "".join(map(_cleaned, text))
    bare = [letter for letter in unicodedata.normalize("NFD", plain) if unicodedata.category(letter) != "Mn"]
    small = "".join(map(str.lower, bare))
    return "".join([f" {letter} " if _is_sign(letter) else letter for letter in small]).split()


@lru_cache(maxsize=4096)
def _cleaned(letter: str) -> str:
    """A letter; a space for any that is none, spaces about an ideograph, nothing for what is not seen."""
    if letter in "\t\n\r" or unicodedata.category(letter)[0] == "Z":
        return " "
    if letter in "\0\ufffd" or unicodedata.category(letter) in ("Cc", "Cf", "Co", "Cs"):
        return ""
    ideograph = ord(letter) >= _IDEOGRAPHS[1][0] and any(low <= ord(letter) <= high for low, high in _IDEOGRAPHS)
    return f" {letter} " if ideograph else letter


@lru_cache(maxsize=4096)
def _is_sign(letter: str) -> bool:
    code = ord(letter)
    ascii_sign = 33 <= code <= 47 or 58 <= code <= 64 or 91 <= code <= 96 or 123 <= code <= 126
    return ascii_sign or unicodedata.category(letter)[0] == "P"


def encoder_file() -> Path:
    """The text encoder's weights: in the folder that BUNRAKU_WEIGHTS names, where they are there, or in the package."""
    path = weights_file("text.safetensors")
    return path if path.is_file() else PACKAGE_WEIGHTS / path.name


def read_header(path: Path) -> dict[str, str]:
    """The "config" and the "tokenizer" of the text encoder, as JSON.

    Raises:
        WeightsError: The file is missing, damaged or another.
    """
    from safetensors import safe_open

    try:
        with safe_open(path, framework="np") as file:
            header: dict[str, str] = file.metadata() or {}
    except Exception as error:
        raise WeightsError(f"{path}: the text encoder cannot be read ({error}); install Bunraku again") from error
    if header.get("kind") != "text" or not {"config", "tokenizer"} <= header.keys():
        raise WeightsError(f"{path}: this is not a text encoder of Bunraku; install Bunraku again")
    return header


@functools.cache
def word_pieces() -> frozenset[str]:
    """Whole words and pieces that the text encoder knows; empty where its file is not there."""
    try:
        return frozenset(json.loads(read_header(encoder_file())["tokenizer"])["model"]["vocab"])
    except (WeightsError, ValueError, KeyError, TypeError):
        return frozenset()
