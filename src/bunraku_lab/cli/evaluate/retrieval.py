"""`bunraku evaluate`: what the networks are worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from bunraku.cli.output.checks import check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.cli.output.report import measured

__all__ = ["Retrieval"]


@dataclass(frozen=True)
class Retrieval:
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
    json: bool = False
    """Print JSON for programs, with a row for each clip."""

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
        measured(result, self.json, _print)


def _print(result: dict[str, Any]) -> None:
    low, high = result["top1_interval"]
    print(f"{result['clips']} clips, {result['candidates']} sentences each, chance {result['chance']:.1%}")
    print(
        f"top 1      {result['top1']:.1%} (95 % interval {low:.1%} to {high:.1%}), {result['times_chance']:.1f} times "
        "chance"
    )
    print(f"top 2, 3   {result['top2']:.1%}, {result['top3']:.1%}")
    print(f"mean rank  {result['mean_rank']:.1f}")
