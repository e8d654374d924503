"""Captured examples that the denoiser attends to: for each sentence the nearest of the pack, by the ranker's vectors.

Only the vectors decide, as in ReMoDiffuse (Zhang et al. 2023): training learns what is of use in an example.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np

from bunraku.errors import WeightsError
from bunraku.generation.denoiser import DenoiserConfig, RetrievedExamples
from bunraku.generation.extractor import RADIUS, Extractor, load_ranker, sentence_vectors
from bunraku.generation.features import FeatureStatistics, mirror
from bunraku.generation.pack import ExamplePack, load_examples
from bunraku.language.captions import mirror_words
from bunraku.language.encoders import TextBatch, TextEncoder, text_encoder


def take_of(name: str) -> str:
    """The take of a clip, of a stretch of one or of a turn cut out of one: `cmu_13_29_jacks@40` -> `cmu_13_29`,
    `snu_WalkSad05@0` -> `snu_WalkSad`.
    """
    clip = name.partition("@")[0].removeprefix("turn_")
    return "_".join(clip.split("_")[:3]) if clip.startswith("cmu_") else clip.rstrip("0123456789")


class ExampleBank:
    """`count` examples of each sentence in a network's units (`statistics`), with the vectors of their sentences,
    computed when needed. The captured ones of the pack are used, not gestures made by code; those longer than `frames`
    are cut.
    """

    def __init__(
        self, pack: ExamplePack, ranker: Extractor, encoder: TextEncoder, statistics: FeatureStatistics, count: int,
        frames: int = 196,
    ):  # fmt: skip
        self.pack, self.ranker, self.encoder, self.statistics = pack, ranker, encoder, statistics
        self.count, self.frames = count, frames
        self._usable = ~pack.made & np.array([bool(example.texts) for example in pack.examples], bool)
        self._known: dict[tuple[int, bool], tuple[np.ndarray, np.ndarray]] = {}

    @cached_property
    def _takes(self) -> list[str]:
        return [take_of(example.name) for example in self.pack.examples]

    def nearest(self, vector: np.ndarray, without: Collection[str] = ()) -> list[tuple[int, bool]]:
        """The nearest examples and whether the mirror image is meant; of an example and its mirror image the nearer.

        Args:
            vector: The ranker's unit vector of the sentence, shape (V,).
            without: Takes that are passed over (`take_of`).
        """
        scores = np.stack([np.mean(self.pack.nearness(vector, mirrored), axis=0) for mirrored in (False, True)])
        usable = self._usable & ~np.isin(self._takes, list(without)) if without else self._usable
        best = np.where(usable, scores.max(0), -np.inf)
        order = np.argsort(-best, kind="stable")[: self.count]
        return [(int(index), bool(scores[1, index] > scores[0, index])) for index in order if usable[index]]

    def __call__(self, text: TextBatch, without: Sequence[Collection[str]] | None = None) -> RetrievedExamples:
        """Examples of each encoded sentence; `without` are the takes that are passed over for each."""
        vectors = self.vectors(text)
        excluded = [()] * len(vectors) if without is None else without
        rows = [self.nearest(*pair) for pair in zip(vectors, excluded, strict=True)]
        found = [[self.example(*one) for one in row] for row in rows]
        lengths = np.zeros((len(rows), self.count), np.int64)
        longest = max((len(values) for row in found for values, _ in row), default=1)
        values = np.zeros((len(rows), self.count, longest, len(self.statistics.mean)), np.float32)
        pooled = np.zeros((len(rows), self.count, self.encoder.pooled_size), np.float32)
        for row, own in enumerate(found):
            for index, (features, vector) in enumerate(own):
                lengths[row, index] = len(features)
                values[row, index, : len(features)] = features
                pooled[row, index] = vector
        return RetrievedExamples(values, lengths, pooled)

    def vectors(self, text: TextBatch) -> np.ndarray:
        """The ranker's unit vectors of encoded sentences, (B, V); it reads as much of their own vectors as it knows."""
        size = self.ranker.config.pooled_size
        return sentence_vectors(self.ranker, TextBatch(text.tokens, text.mask, text.pooled[:, :size])) / RADIUS

    def example(self, index: int, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
        """Features of an example in the network's units, shape (N, D), float16, and the vector of its sentence, shape
        (P,).
        """
        key = (index, mirrored)
        if key not in self._known:
            features, text = self.pack.features(index)[: self.frames], self.pack.examples[index].texts[0]
            if mirrored:
                features, text = mirror(features), mirror_words(text)
            vector = self.encoder.encode([text]).pooled[0]
            self._known[key] = (self.statistics.normalise(features).astype(np.float16), vector)
        return self._known[key]


def example_bank(
    config: DenoiserConfig, statistics: FeatureStatistics, pack: ExamplePack | None = None,
    encoder: TextEncoder | None = None,
) -> ExampleBank:  # fmt: skip
    """The bank of a denoiser that attends to examples; with the shipped pack it is kept between calls.

    Args:
        config, statistics: Of the denoiser.
        pack: In place of the shipped examples.
        encoder: In place of the denoiser's own text encoder.

    Raises:
        WeightsError: There are no examples beside the shipped weights.
    """
    pack = pack or load_examples()
    if pack is None:
        raise WeightsError(
            "these weights attend to captured examples, but examples.safetensors is missing beside the shipped "
            "weights; install Bunraku again"
        )
    if encoder is not None:
        return ExampleBank(pack, load_ranker(), encoder, statistics, config.examples)
    key = (statistics.mean.tobytes(), statistics.std.tobytes())
    return _bank(pack, config.text_encoder, key, config.examples)


@functools.lru_cache(maxsize=1)
def _bank(pack: ExamplePack, encoder: str, units: tuple[bytes, bytes], count: int) -> ExampleBank:
    statistics = FeatureStatistics(*(np.frombuffer(part, np.float32) for part in units))
    return ExampleBank(pack, load_ranker(), text_encoder(encoder), statistics, count)
