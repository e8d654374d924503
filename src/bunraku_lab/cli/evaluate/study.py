"""`bunraku evaluate study`: what people said in a blind study."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from bunraku.errors import OptionError

__all__ = ["EvaluateStudy"]


@dataclass(frozen=True)
class EvaluateStudy:
    """Mean ranks of a blind study with 95 % intervals over people, shares of firsts, Friedman's test, and who was left
    out.

    Example: bunraku evaluate study study
    """

    study: tyro.conf.Positional[Path]
    """The folder of `bunraku study make`, with its answers."""
    json: bool = False
    """Print JSON for programs."""

    def run(self) -> None:
        from bunraku.studio.study.answers import QUESTIONS, load_answers, load_study
        from bunraku_lab.evaluation.study.ranks import outcome

        study = load_study(self.study)
        answers = load_answers(study)
        if not answers:
            raise OptionError(
                f"{self.study}: nobody has answered yet; show it with: bunraku studio --study {self.study}"
            )
        found = outcome(study, answers)
        if self.json:
            print(json.dumps(asdict(found), indent=2))
            return
        print(f"{found.people} people, {found.comparisons} comparisons; rank 1 is the best")
        width = max(len(method) for method in study.compared)
        for question in QUESTIONS:
            print(f"\n{question} (Friedman's test over people: p = {found.p_values[question]:.2g})")
            for method, rank in sorted(found.ranks[question].items(), key=lambda pair: pair[1].mean):
                print(
                    f"  {method:<{width}}  {rank.mean:.2f} ({rank.low:.2f} to {rank.high:.2f})  "
                    f"first in {100 * rank.firsts:.0f} %"
                )
        for person, why in found.left_out.items():
            print(f"\nleft out: {person}, who {why}")
