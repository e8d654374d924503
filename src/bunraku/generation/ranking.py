"""The best of several candidates, by a network that was trained apart from the judge of the tables, and by rule.

Each sentence of a script is compared with its own part of the motion; a motion's score is the mean of their cosines.
What a sentence plainly says (`generation.agreement`) weighs more: a punch with the wrong hand is no choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.generation.agreement import agreement
from bunraku.generation.composition import clause_spans
from bunraku.generation.extractor import LONGEST, RADIUS, SHORTEST, Extractor, embed_motions
from bunraku.generation.features import decode
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["Candidate", "choose", "script_agreement", "script_scores"]

WEIGHT = 0.5
"""Of what is plainly said beside a cosine; candidates' cosines differ by a tenth."""
CAPTURED = 0.1
"""For a candidate that starts from a captured example: the ranker hardly sees that a motion is too small."""
ENOUGH = 0.75
"""Agreement below which a motion is drawn again."""
ATTEMPTS = 4
"""How often candidates are drawn at the most."""


@dataclass(frozen=True)
class Candidate:
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


def script_scores(
    ranker: Extractor, text: Mapping[str, np.ndarray], motions: Sequence[np.ndarray],
    scripts: Sequence[Sequence[tuple[Clause, int]]],
) -> np.ndarray:  # fmt: skip
    """How well each motion does what its script says, the mean cosine over its sentences, shape (M,).

    Args:
        ranker: From `matching.load_ranker`.
        text: Its vectors of the sentences (`matching.embed_sentences`).
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
    vectors = embed_motions(ranker, pieces)
    total, weight = np.zeros(len(motions)), np.zeros(len(motions))
    for vector, (index, sentence, frames) in zip(vectors, owners, strict=True):
        total[index] += frames * float(vector @ text[sentence]) / RADIUS**2
        weight[index] += frames
    return total / np.maximum(weight, 1)


def script_agreement(motion: np.ndarray, script: Sequence[tuple[Clause, int]], led: bool = False) -> float | None:
    """How far a motion does what its sentences plainly say: the `agreement` of the one that holds least.

    Args:
        motion: Features, shape (N, 271).
        script: Its clauses with the frames that each lasts.
        led: It starts from examples, so that limbs go where they are told.
    """
    found = []
    for clause, span in clause_spans(script):
        if led and isinstance(clause.told, Posing):
            continue
        part = motion[span]
        score = agreement(clause, decode(part)) if len(part) >= SHORTEST else None
        if score is not None:
            found.append(score)
    return min(found, default=None)


def choose(
    draw: Callable[[list[int], list[int]], list[Candidate]], motions: int, candidates: int,
    score: Callable[[Sequence[Candidate]], np.ndarray],
) -> list[Candidate]:  # fmt: skip
    """The best candidate of each motion; where not even that does what is plainly said, more are drawn.

    Args:
        draw: Draws candidates: asked for motions and, for each, which of its candidates.
        motions: How many there are.
        candidates: Of each, at a time.
        score: What the ranker says of them, shape (M,).

    Returns:
        One for each motion, the same whatever motions stand beside it.
    """
    best: dict[int, tuple[float, Candidate]] = {}
    wanted = list(range(motions))
    for attempt in range(ATTEMPTS):
        rows = [motion for motion in wanted for _ in range(candidates)]
        indices = [attempt * candidates + index for _ in wanted for index in range(candidates)]
        drawn = draw(rows, indices)
        for motion, one, cosine in zip(rows, drawn, score(drawn).tolist(), strict=True):
            total = cosine + WEIGHT * (one.agreement or 0.0) + CAPTURED * one.captured
            if motion not in best or total > best[motion][0]:
                best[motion] = (total, one)
        wanted = [motion for motion in wanted if (said := best[motion][1].agreement) is not None and said < ENOUGH]
        if not wanted:
            break
    return [best[motion][1] for motion in range(motions)]
