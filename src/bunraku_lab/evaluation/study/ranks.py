"""Mean ranks with intervals, Friedman's test, and who did not look."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from bunraku.studio.study.answers import FROZEN, QUESTIONS, Answer, Study

__all__ = ["MethodRank", "Outcome", "left_out", "outcome"]

ROUNDS = 5000
LEVEL = 0.95


@dataclass(frozen=True)
class MethodRank:
    """How one method fares in one question.

    Args:
        mean: Its mean rank, 1 is the best.
        low: Lower end of the 95 % interval, by resampling people.
        high: Upper end.
        firsts: Share of comparisons in which it is the best.
    """

    mean: float
    low: float
    high: float
    firsts: float


@dataclass(frozen=True)
class Outcome:
    """What a study says.

    Args:
        people: Who counts.
        comparisons: Trials that count.
        ranks: For each question and method.
        p_values: Of Friedman's test over people for each question; NaN where there are fewer than three people or
            methods.
        left_out: Who does not count, and why.
    """

    people: int
    comparisons: int
    ranks: dict[str, dict[str, MethodRank]]
    p_values: dict[str, float]
    left_out: dict[str, str]


def left_out(study: Study, answers: list[Answer]) -> dict[str, str]:
    """Who is left out, and why: who calls a frozen clip the best, or turns the order of a repeated trial round."""
    by_person: dict[str, dict[str, Answer]] = defaultdict(dict)
    for answer in answers:
        by_person[answer.participant][answer.trial] = answer
    out = {}
    for person, own in by_person.items():
        for answer in own.values():
            frozen = [clip for clip in study.trial(answer.trial)["clips"] if study.methods[clip] == FROZEN]  # type: ignore[index]
            if any(answer.ranks[question][clip] == 1 for clip in frozen for question in ("overall", "text")):
                out[person] = "called a clip that does not move the best"
        for again, first in study.repeats.items():
            if again in own and first in own and person not in out:
                agreement = _agreement(study, own[first], own[again])
                if agreement < 0:
                    out[person] = f"ranked a repeated trial the other way round (correlation {agreement:.2f})"
    return out


def _agreement(study: Study, one: Answer, other: Answer) -> float:
    """Mean correlation of the ranks of two trials with the same methods."""
    from scipy.stats import spearmanr

    found = []
    for question in one.ranks:
        ranks = [
            {study.methods[clip]: rank for clip, rank in answer.ranks[question].items()} for answer in (one, other)
        ]
        methods = sorted(ranks[0])
        found.append(float(spearmanr([ranks[0][m] for m in methods], [ranks[1][m] for m in methods]).statistic))
    return float(np.mean(found))


def outcome(study: Study, answers: list[Answer], seed: int = 0) -> Outcome:
    """What the answers of those who looked say; checks do not count.

    Args:
        study: The study.
        answers: All answers; of a trial that somebody answered twice the last counts.
        seed: Of the resampling.
    """
    from scipy.stats import friedmanchisquare  # which takes a second to load, as below

    without = left_out(study, answers)
    latest = {(one.participant, one.trial): one for one in answers}
    kept = [one for one in latest.values() if one.participant not in without and not study.is_check(one.trial)]
    people = sorted({one.participant for one in kept})
    methods, generator = study.compared, np.random.default_rng(seed)
    ranks: dict[str, dict[str, MethodRank]] = {}
    p_values = {}
    for question in QUESTIONS:
        # ranks of each comparison by method, shape (comparisons, methods); whose they are
        table = np.array([[_rank(study, one, question, method) for method in methods] for one in kept], float).reshape(
            len(kept), len(methods)
        )
        whose = np.array([people.index(one.participant) for one in kept], int)
        sums = np.zeros((len(people), len(methods)))
        np.add.at(sums, whose, table)
        counts = np.bincount(whose, minlength=len(people))
        drawn = generator.integers(0, max(len(people), 1), (ROUNDS, len(people))) if people else np.zeros((0, 0), int)
        means = sums[drawn].sum(1) / counts[drawn].sum(1)[:, None] if people else np.full((1, len(methods)), np.nan)
        low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
        ranks[question] = {
            method: MethodRank(
                float(table[:, index].mean()) if kept else float("nan"), float(low[index]), float(high[index]),
                float((table[:, index] == 1).mean()) if kept else float("nan"),
            )
            for index, method in enumerate(methods)
        }  # fmt: skip
        own = sums / np.maximum(counts, 1)[:, None]
        enough = len(people) > 2 and len(methods) > 2
        p_values[question] = float(friedmanchisquare(*own.T).pvalue) if enough else float("nan")
    return Outcome(len(people), len(kept), ranks, p_values, without)


def _rank(study: Study, answer: Answer, question: str, method: str) -> float:
    return next(rank for clip, rank in answer.ranks[question].items() if study.methods[clip] == method)
