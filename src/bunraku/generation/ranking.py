"""The best of several candidates, by a network that was trained apart from the judge of the tables, and by rule.

Each sentence of a script is compared with its own part of the motion; a motion's score is the mean of their cosines.
What a sentence plainly says and does not say (`verifier`) weighs more: a punch with the wrong hand is no choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.generation.composition import clause_spans
from bunraku.generation.extractor import LONGEST, RADIUS, SHORTEST, Extractor, embed_motions
from bunraku.generation.features import decode
from bunraku.generation.verifier import Verdict, verify
from bunraku.language.sentence import Clause

# Chosen by eye on sheets of generated motion.
WEIGHT = 0.5
"""Of the agreement beside a cosine; candidates' cosines differ by a tenth. Chosen by eye, as are the next two."""
CAPTURED = 0.1  # for a candidate that starts from a captured example: the ranker hardly sees that a motion is too small
ENOUGH = 0.75  # agreement below which a motion is drawn again
ATTEMPTS = 4  # most draws of candidates


@dataclass(frozen=True)
class Candidate:
    """One candidate."""

    motion: np.ndarray  # features of each frame, shape (N, 271)
    adaptation: np.ndarray  # offsets of local translations [m], shape (N, K, 3)
    script: Sequence[tuple[Clause, int]]  # its clauses with the frames that each lasts
    verdict: Verdict | None = None  # the claim of theirs that holds least; None where they make no claim
    captured: bool = False  # it starts from a captured example


def script_scores(
    ranker: Extractor, text: Mapping[str, np.ndarray], motions: Sequence[np.ndarray],
    scripts: Sequence[Sequence[tuple[Clause, int]]],
) -> np.ndarray:  # fmt: skip
    """How well each motion (N, 271) does what its script says, (M,): the ranker's mean cosine over its sentences."""
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


def script_verdict(motion: np.ndarray, script: Sequence[tuple[Clause, int]], led: bool = False) -> Verdict | None:
    """The claim of a script that holds least of a motion (N, 271); None where it makes none. `led` motions start from
    examples, so that limbs go where the sentence says.
    """
    parts = [(clause, motion[span]) for clause, span in clause_spans(script)]
    verdicts = [verify(clause, decode(part), not led) for clause, part in parts if len(part) >= SHORTEST]
    return min((one for one in verdicts if one is not None), key=lambda one: one.agreement, default=None)


def choose(
    draw: Callable[[list[int], list[int]], list[Candidate]], motions: int, candidates: int,
    score: Callable[[Sequence[Candidate]], np.ndarray],
) -> list[Candidate]:  # fmt: skip
    """The best candidate of each motion, the same whatever motions stand beside it; where not even that does what is
    plainly said, more are drawn.

    Args:
        draw: Draws candidates of motions, by the motion and the index of each.
        motions: How many there are.
        candidates: Of each, at a time.
        score: The ranker's scores, shape (M,).
    """
    best: dict[int, tuple[float, Candidate]] = {}
    wanted = list(range(motions))
    for attempt in range(ATTEMPTS):
        rows = [motion for motion in wanted for _ in range(candidates)]
        indices = [attempt * candidates + index for _ in wanted for index in range(candidates)]
        drawn = draw(rows, indices)
        for motion, candidate, cosine in zip(rows, drawn, score(drawn).tolist(), strict=True):
            total = cosine + WEIGHT * min(_agreement(candidate), ENOUGH) + CAPTURED * candidate.captured
            if motion not in best or total > best[motion][0]:
                best[motion] = (total, candidate)
        wanted = [motion for motion in wanted if _agreement(best[motion][1]) < ENOUGH]
        if not wanted:
            break
    return [best[motion][1] for motion in range(motions)]


def _agreement(candidate: Candidate) -> float:
    return 1.0 if candidate.verdict is None else candidate.verdict.agreement
