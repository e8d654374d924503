"""`bunraku evaluate transfer`: the table of motion transfer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from bunraku.cli.output.checks import check_output, check_range
from bunraku.cli.output.progress import stages
from bunraku.errors import FormatError
from bunraku.nn.spread import parse_jobs
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, bar_table

__all__ = ["EvaluateTransfer"]


@dataclass(frozen=True)
class EvaluateTransfer(Printed):
    """Measure motion transfer: each character with a walk, a dance, a kick, a sitting down and a roll.

    Example: bunraku evaluate transfer --characters archive/characters --motions archive/bvh --json
    """

    characters: Path
    """Folder of characters, searched through."""
    motions: Path
    """Folder of motions: with a captions.csv beside them, or named by what is done."""
    limit: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Take only so many characters, spread over all."""
    mmd: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of MMD models and VMD files with leg IK, for the rows of soles; left out without it."""
    work: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where rows of characters are kept, so that the same command goes on where it was stopped."""
    results: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Another method's results, an animated file for each row of what --pairs-to writes, named by its column file."""
    pairs_to: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Write the pairs of character and motion for another method (.csv), and measure nothing."""
    no_speed: bool = False
    """Leave out the times, which say little on a busy machine."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the characters, or "ray" for a Ray cluster."""

    def run(self) -> None:
        check_range("--limit", self.limit, 1, 100_000)
        for folder in (self.characters, self.motions, self.mmd, self.results):
            if folder is not None and not folder.is_dir():
                raise FormatError(folder, "there is no such folder")
        if self.pairs_to is not None:
            check_output(self.pairs_to, [".csv"])
        jobs = parse_jobs(self.jobs)
        from bunraku_lab.evaluation.transfer.table import evaluate_transfer, write_transfer_pairs

        if self.pairs_to is not None:
            print(f"wrote {write_transfer_pairs(self.pairs_to, self.characters, self.motions, self.limit)}")
            return
        with stages() as report:
            how: dict[str, Any] = {"mmd": self.mmd, "limit": self.limit, "work": self.work, "speed": not self.no_speed}
            how |= {"jobs": jobs, "results": self.results}
            result = evaluate_transfer(self.characters, self.motions, progress=report, **how)
        self.show(result, _report)


def _report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.transfer.table import BARS

    counts = result["counts"]
    return Report([
        f"{counts['characters']} characters, {counts['humanoids']} humanoids with a rig, {counts['clips']} of them "
        "with clips; motions: " + ", ".join(f"{kind} {name}" for kind, name in result["motions"].items()),
        bar_table(BARS, result),
        *(f"failed {name}: {reason}" for name, reason in result["failed"].items()),
    ])  # fmt: skip
