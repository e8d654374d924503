"""`bunraku evaluate`: what the networks are worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from bunraku.cli.output.checks import check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, Table

__all__ = ["Retrieval"]


@dataclass(frozen=True)
class Retrieval(Printed):
    """Test how well the sentence of a held-out motion is found among others, with the diffusion model as the judge.

    A model that ignores its text is right one time in as many as there are candidates.

    Example: bunraku evaluate retrieval --data data/motions --json
    """

    data: Path
    """Folder that `bunraku data motions` wrote."""
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of the diffusion model. Default: the shipped ones."""
    split: Literal["test", "val", "train"] = "test"
    """Which clips."""
    candidates: int = 32
    """Sentences to choose from, 2 to 500."""
    seed: int = 0
    """Of the choice and of the noise."""

    def run(self) -> None:
        check_range("--candidates", self.candidates, 2, 500)
        check_source(self.data, "make it with `bunraku data motions`")
        if self.checkpoint is not None:
            check_input(self.checkpoint)
        from bunraku_lab.evaluation.motion.retrieval import retrieval

        with stages() as report:
            result = retrieval(
                self.data,
                checkpoint=self.checkpoint,
                split=self.split,
                candidates=self.candidates,
                seed=self.seed,
                progress=lambda done, total: report("retrieval", done / total),
            )
        self.show(result, _report)


def _report(result: dict[str, Any]) -> Report:
    low, high = result["top1_interval"]
    rows = [["sentence of the motion", "share", "95 % interval", "over chance"]]
    rows.append(["top 1", f"{result['top1']:.1%}", f"{low:.1%} to {high:.1%}", f"{result['times_chance']:.1f}"])
    rows += [[f"top {count}", f"{result[f'top{count}']:.1%}", "", ""] for count in (2, 3)]
    return Report([
        f"{result['clips']} clips, {result['candidates']} sentences each, chance {result['chance']:.1%}; mean rank "
        f"{result['mean_rank']:.1f}",
        Table(rows),
    ])  # fmt: skip
