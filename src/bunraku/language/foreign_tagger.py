"""What the table of words does not have: a small network says which movement a word of a sentence is.

Each word (in Japanese and Chinese each sign) is the mean of the vectors of its hashed pieces; with the means of what
stands before it, of what stands after it and of the sentence it goes through one layer, which gives the probability of
each movement. The network was trained on pairs of sentences of which only the English says what is done
(`bunraku train tagger`), so it finds the word by itself.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bunraku.core.nn.checkpoints import config_of, dated_checkpoint, load_network
from bunraku.core.nn.layers import Linear, Weights
from bunraku.errors import WeightsError
from bunraku.language.foreign_words import fold, spaced_words
from bunraku.language.word_table import Concept

KIND = "tagger"
SURE = 0.5
"""The probability from which a word is taken for a movement; set on pairs that were neither trained on nor measured."""
_UNSPACED = ("ja", "zh")
_REACH = 3, 6
"""Words before and after one that tell what it means, and signs in Japanese and Chinese."""
_GRAMS = 3, 4, 5
"""Letters of the pieces of a word, its ends being letters too."""


@dataclass(frozen=True)
class TaggerConfig:
    """The network."""

    buckets: int = 16384  # rows of the matrix of pieces
    width: int = 24  # numbers of a piece's vector
    hidden: int = 96  # of the layer
    # the movements, each as the table of words has it in English: "{wave}", "{raise} <the arms>"
    verbs: tuple[str, ...] = ()


class Unit(NamedTuple):
    """A word, or a sign of Japanese or Chinese: where it stands in the sentence, and its hashed pieces."""

    start: int
    stop: int
    pieces: tuple[int, ...]


def units(text: str, language: str) -> list[Unit]:
    """The words or signs of a sentence, with hashes of 32 bits.

    Args:
        text: A sentence.
        language: "de", "fr", "es", "ja" or "zh".
    """
    if language not in _UNSPACED:
        return [Unit(start, stop, _word(text[start:stop], language)) for start, stop in spaced_words(text)]
    signs = [index for index, letter in enumerate(text) if letter.isalnum() or letter in "ー々"]
    padded = f"  {text}   ".lower()
    out = []
    for at in signs:
        here = at + 2
        spans = ((0, 1), (-1, 1), (0, 2), (-2, 1), (-1, 2), (0, 3), (-1, 3), (0, 4))
        pieces = [f"{language} {padded[here + first : here + last]}" for first, last in spans]
        out.append(Unit(at, at + 1, tuple(zlib.crc32(piece.encode()) for piece in pieces)))
    return out


def reach_of(language: str) -> int:
    """How many units before and after one tell what it means."""
    return _REACH[language in _UNSPACED]


@functools.lru_cache(maxsize=65536)
def _word(word: str, language: str) -> tuple[int, ...]:
    marked = f"<{fold(word)}>"
    grams = dict.fromkeys(marked[at : at + size] for size in _GRAMS for at in range(len(marked) - size + 1))
    return tuple(zlib.crc32(f"{language} {piece}".encode()) for piece in (marked, *grams))


class Tagger:
    """The network in numpy.

    Args:
        config: Its sizes.
        weights: Of a checkpoint: the matrix in steps of int8, and how large the steps of each column are.
    """

    def __init__(self, config: TaggerConfig, weights: Weights):
        self.config = config
        self.steps = weights.array("pieces.steps", config.buckets, config.width)
        self.scale = weights.array("pieces.scale", config.width)
        self.enter = weights.linear("enter", 4 * config.width, config.hidden)
        self.leave = weights.linear("leave", config.hidden, len(config.verbs))

    def __call__(self, found: Sequence[Unit], language: str) -> np.ndarray:
        """The probability of each movement for each unit, shape (T, V)."""
        rows = [self.steps[np.array(unit.pieces) % self.config.buckets].mean(0) for unit in found]
        return probabilities(np.stack(rows) * self.scale, reach_of(language), self.enter, self.leave)


def probabilities(own: np.ndarray, reach: int, enter: Linear, leave: Linear) -> np.ndarray:
    """From the vectors of units, shape (T, C), to the probability of each movement, shape (T, V)."""
    count = len(own)
    sums = np.concatenate([np.zeros_like(own[:1]), own.cumsum(0)])
    at = np.arange(count)
    first, last = np.maximum(at - reach, 0), np.minimum(at + 1 + reach, count)
    before = (sums[at] - sums[first]) / np.maximum(at - first, 1)[:, None]
    after = (sums[last] - sums[at + 1]) / np.maximum(last - at - 1, 1)[:, None]
    mean = np.broadcast_to(own.mean(0), own.shape)
    scores = leave(np.maximum(enter(np.concatenate([own, before, after, mean], axis=1)), 0))
    return np.asarray(1 / (1 + np.exp(-np.clip(scores, -30, 30))))


@functools.lru_cache(maxsize=2)
def _loaded(path: Path, date: int) -> Tagger:
    return load_network(path, KIND, lambda config, weights: Tagger(config_of(TaggerConfig, config), weights))


def load_tagger(path: str | Path | None = None) -> Tagger:
    """The shipped network, or another.

    Raises:
        WeightsError: The file is missing, damaged or of another kind.
    """
    return _loaded(*dated_checkpoint(KIND, path))


def tagged(text: str, language: str, concepts: Sequence[Concept]) -> list[Concept]:
    """The words of a sentence, those that the table does not have being movements where the network is sure.

    Sides, numbers and order are the table's, and so is what it reads.

    Args:
        text: The sentence.
        language: "de", "fr", "es", "ja" or "zh".
        concepts: What a scan of the table found.
    """
    try:
        network = load_tagger()
    except WeightsError:  # the table alone reads, as `bunraku doctor` says
        return list(concepts)
    found = units(text, language)
    scores = network(found, language) if found else np.zeros((0, len(network.config.verbs)))
    return list(_read(concepts, found, scores, network.config.verbs))


def _read(
    concepts: Sequence[Concept], found: Sequence[Unit], said: np.ndarray, verbs: Sequence[str]
) -> Iterator[Concept]:
    taken: set[str] = set()
    for concept in concepts:
        if concept.kind in ("then", "and", "while", "before", "after", "comma", "stop"):
            taken = set()
        elif concept.kind == "verb":
            taken.add(concept.value)
        elif concept.kind == "unknown":
            inside = [at for at, unit in enumerate(found) if concept.start <= unit.start and unit.stop <= concept.stop]
            likely = said[inside].max(0, initial=0.0)
            best = int(likely.argmax()) if len(likely) else 0
            if len(likely) and likely[best] >= SURE and verbs[best] not in taken:
                concept = replace(concept, kind="verb", value=verbs[best])
                taken.add(verbs[best])
        yield concept
