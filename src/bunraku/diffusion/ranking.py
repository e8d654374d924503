"""The best of several candidates, by a network that was trained apart from the judge of the tables.

Each sentence of a script is compared with its own part of the motion; a motion's score is the mean of their cosines.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bunraku.diffusion.matching import RADIUS, RANKER, Extractor, embed_motions, embed_sentences, load_extractor
from bunraku.language.encoders import TextEncoder
from bunraku.nn.checkpoints import shipped_checkpoint

__all__ = ["best_of", "load_ranker", "script_scores"]

LONGEST = 196
"""Frames that the ranker looks at at once; longer parts are looked at in pieces."""
SHORTEST = 8


def load_ranker(path: str | Path | None = None) -> Extractor:
    """The ranker, kept between calls as long as the file does not change.

    Args:
        path: Weights in place of the shipped ones.

    Raises:
        WeightsError: The weights are missing or broken.
    """
    file = shipped_checkpoint("ranker") if path is None else Path(path)
    return _load(file, file.stat().st_mtime_ns if file.is_file() else 0)


@functools.lru_cache(maxsize=2)
def _load(path: Path, changed: int) -> Extractor:
    return load_extractor(path, kind=RANKER)


def script_scores(
    ranker: Extractor,
    encoder: TextEncoder,
    motions: Sequence[np.ndarray],
    scripts: Sequence[Sequence[tuple[str, int]]],
) -> np.ndarray:
    """How well each motion does what its script says, the mean cosine over its sentences, shape (M,).

    Args:
        ranker: From `load_ranker`.
        encoder: The text encoder that it was trained with.
        motions: Features of each motion (see `diffusion.features`), shape (N, 271).
        scripts: For each motion its sentences with the frames that each lasts.
    """
    pieces: list[np.ndarray] = []
    owners: list[tuple[int, str, int]] = []
    for index, (features, script) in enumerate(zip(motions, scripts, strict=True)):
        start = 0
        for sentence, frames in script:
            part = features[start : start + frames]
            start += frames
            for cut in np.array_split(part, -(-len(part) // LONGEST)) if len(part) >= SHORTEST else ():
                pieces.append(cut)
                owners.append((index, sentence, len(cut)))
    if not pieces:
        return np.zeros(len(motions))
    text = embed_sentences(ranker, encoder, [sentence for _, sentence, _ in owners])
    vectors = embed_motions(ranker, pieces)
    total, weight = np.zeros(len(motions)), np.zeros(len(motions))
    for vector, (index, sentence, frames) in zip(vectors, owners, strict=True):
        total[index] += frames * float(vector @ text[sentence]) / RADIUS**2
        weight[index] += frames
    return total / np.maximum(weight, 1)


def best_of(scores: np.ndarray, candidates: int) -> list[int]:
    """The place of the best candidate of each motion, where candidates of a motion follow each other."""
    rows = scores.reshape(-1, candidates)
    return [row * candidates + int(best) for row, best in enumerate(rows.argmax(axis=1))]
