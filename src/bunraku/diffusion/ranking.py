"""The best of several candidates, by a network that was trained apart from the judge of the tables, and by rule.

Each sentence of a script is compared with its own part of the motion; a motion's score is the mean of their cosines.
What a sentence plainly says (`language.description.agreement`) weighs more: a punch with the wrong hand is no choice.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.diffusion.features import decode
from bunraku.diffusion.matching import RADIUS, RANKER, Extractor, embed_motions, embed_sentences, load_extractor
from bunraku.formats.files import weights_folder
from bunraku.language.description.agreement import agreement
from bunraku.language.encoders import TextEncoder
from bunraku.language.sentence import Clause, clause_spans
from bunraku.nn.checkpoints import dated_checkpoint

__all__ = ["Drawn", "choose", "load_critic", "load_ranker", "script_agreement", "script_scores"]

WEIGHT = 0.5
"""Of what is plainly said beside a cosine; candidates' cosines differ by a tenth."""
CAPTURED = 0.1
"""For a candidate that starts from a captured example: the ranker hardly sees that a motion is too small."""
ENOUGH = 0.75
"""Agreement below which a motion is drawn again."""
ATTEMPTS = 4
"""How often candidates are drawn at the most."""
LONGEST = 196
"""Frames that the ranker looks at at once; longer parts are looked at in pieces."""
SHORTEST = 8


@dataclass(frozen=True)
class Drawn:
    """One candidate.

    Args:
        motion: Features of each frame, shape (N, 271).
        adaptation: Offsets of local translations [m], shape (N, K, 3).
        script: Its clauses with the frames that each lasts.
        agreement: How far it does what they plainly say; None where they say nothing of the kind.
        captured: It starts from a captured example.
    """

    motion: np.ndarray
    adaptation: np.ndarray
    script: Sequence[tuple[Clause, int]]
    agreement: float | None = None
    captured: bool = False


def load_ranker(path: str | Path | None = None) -> Extractor:
    """The ranker, kept between calls as long as the file does not change.

    Args:
        path: Weights in place of the shipped ones.

    Raises:
        WeightsError: The weights are missing or broken.
    """
    return _load(*dated_checkpoint("ranker", path))


def load_critic() -> Extractor | None:
    """The critic, which pulls motions towards their sentences (`sampling.sentence_pull`) and, trained apart from the
    ranker, chooses none; None where the file was taken away.

    Raises:
        WeightsError: The weights are broken.
    """
    if not (weights_folder() / "critic.safetensors").is_file():
        return None
    return _load(*dated_checkpoint("critic"))


@functools.lru_cache(maxsize=4)
def _load(path: Path, changed: int) -> Extractor:
    return load_extractor(path, kind=RANKER)


def script_scores(
    ranker: Extractor,
    encoder: TextEncoder,
    motions: Sequence[np.ndarray],
    scripts: Sequence[Sequence[tuple[Clause, int]]],
) -> np.ndarray:
    """How well each motion does what its script says, the mean cosine over its sentences, shape (M,).

    Args:
        ranker: From `load_ranker`.
        encoder: The text encoder that it was trained with.
        motions: Features of each motion (see `diffusion.features`), shape (N, 271).
        scripts: For each motion its clauses with the frames that each lasts.
    """
    pieces: list[np.ndarray] = []
    owners: list[tuple[int, str, int]] = []
    for index, (features, script) in enumerate(zip(motions, scripts, strict=True)):
        for clause, span in clause_spans(script):
            part = features[span]
            for cut in np.array_split(part, -(-len(part) // LONGEST)) if len(part) >= SHORTEST else ():
                pieces.append(cut)
                owners.append((index, clause.text, len(cut)))
    if not pieces:
        return np.zeros(len(motions))
    text = embed_sentences(ranker, encoder, [sentence for _, sentence, _ in owners])
    vectors = embed_motions(ranker, pieces)
    total, weight = np.zeros(len(motions)), np.zeros(len(motions))
    for vector, (index, sentence, frames) in zip(vectors, owners, strict=True):
        total[index] += frames * float(vector @ text[sentence]) / RADIUS**2
        weight[index] += frames
    return total / np.maximum(weight, 1)


def script_agreement(motion: np.ndarray, script: Sequence[tuple[Clause, int]]) -> float | None:
    """How far a motion does what its sentences plainly say: the `agreement` of the one that holds least.

    Args:
        motion: Features, shape (N, 271).
        script: Its clauses with the frames that each lasts.
    """
    found = []
    for clause, span in clause_spans(script):
        part = motion[span]
        score = agreement(clause, decode(part)) if len(part) >= SHORTEST else None
        if score is not None:
            found.append(score)
    return min(found, default=None)


def choose(
    draw: Callable[[list[int], list[int]], list[Drawn]],
    motions: int,
    candidates: int,
    score: Callable[[Sequence[Drawn]], np.ndarray],
) -> list[Drawn]:
    """The best candidate of each motion; where not even that does what is plainly said, more are drawn.

    Args:
        draw: Draws candidates: asked for motions and, for each, which of its candidates.
        motions: How many there are.
        candidates: Of each, at a time.
        score: What the ranker says of them, shape (M,).

    Returns:
        One for each motion, the same whatever motions stand beside it.
    """
    best: dict[int, tuple[float, Drawn]] = {}
    wanted = list(range(motions))
    for attempt in range(ATTEMPTS):
        rows = [motion for motion in wanted for _ in range(candidates)]
        places = [attempt * candidates + place for _ in wanted for place in range(candidates)]
        drawn = draw(rows, places)
        for motion, one, cosine in zip(rows, drawn, score(drawn).tolist(), strict=True):
            total = cosine + WEIGHT * (one.agreement or 0.0) + CAPTURED * one.captured
            if motion not in best or total > best[motion][0]:
                best[motion] = (total, one)
        wanted = [motion for motion in wanted if (said := best[motion][1].agreement) is not None and said < ENOUGH]
        if not wanted:
            break
    return [best[motion][1] for motion in range(motions)]
