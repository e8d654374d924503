"""`bunraku evaluate study`: what people said in a blind study."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from bunraku.errors import OptionError
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, Table

if TYPE_CHECKING:
    from bunraku.studio.study.answers import Study
    from bunraku_lab.evaluation.study.ranks import Outcome

__all__ = ["EvaluateStudy"]


@dataclass(frozen=True)
class EvaluateStudy(Printed):
    """Mean ranks of a blind study with 95 % intervals over people, shares of firsts, Friedman's test, and who was left
    out.

    Example: bunraku evaluate study study
    """

    study: tyro.conf.Positional[Path]
    """The folder of `bunraku study make`, with its answers."""

    def run(self) -> None:
        from bunraku.studio.study.answers import load_answers, load_study
        from bunraku_lab.evaluation.study.ranks import outcome

        study = load_study(self.study)
        answers = load_answers(study)
        if not answers:
            raise OptionError(
                f"{self.study}: nobody has answered yet; show it with: bunraku studio --study {self.study}"
            )
        found = outcome(study, answers)
        self.show(asdict(found), lambda _: _report(study, found))


def _report(study: Study, found: Outcome) -> Report:
    from bunraku.studio.study.answers import QUESTIONS

    parts: list[Table | str] = [f"{found.people} people, {found.comparisons} comparisons; rank 1 is the best"]
    for question in QUESTIONS:
        rows = [["method", "rank (95 % interval)", "first in"]]
        for method, rank in sorted(found.ranks[question].items(), key=lambda pair: pair[1].mean):
            interval = f"{rank.mean:.2f} ({rank.low:.2f} to {rank.high:.2f})"
            rows.append([method, interval, f"{100 * rank.firsts:.0f} %"])
        title = f"{question} (Friedman's test over people: p = {found.p_values[question]:.2g})"
        parts.append(Table(rows, left=2, title=title))
    return Report(parts + [f"left out: {person}, who {why}" for person, why in found.left_out.items()])
