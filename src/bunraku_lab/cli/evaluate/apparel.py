"""`bunraku evaluate apparel`: what learned apparel is worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.cli.output.checks import check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.errors import OptionError
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, Table, bar_table

__all__ = ["EvaluateApparel"]


@dataclass(frozen=True)
class EvaluateApparel(Printed):
    """Measure learned apparel on test characters in test motions, beside what skinning alone gives: the tables of
    MMDMC, and starts from rest of 2, 6 and 60 s.

    Example: bunraku evaluate apparel --data data/apparel --motions data/motions --files gene.pmx --json
    """

    data: Path | None = None
    """Folder that `bunraku data apparel` wrote; without it only --files are measured."""
    motions: Path | None = None
    """Folder that `bunraku data motions` wrote, for the clips of a minute; without it they are left out."""
    files: tuple[Path, ...] = ()
    """PMX, PMD or VRM files with physics, none of which was trained on."""
    clips: int = 24
    """Most clips of the data set, 1 to 10000."""
    weights: Path | None = None
    """Displacement network to measure. Default: the shipped one."""
    masks: Path | None = None
    """Segmentation network to measure. Default: the shipped one."""
    bodies: tuple[Path, ...] = ()
    """Body networks to measure (Table 4), the first in Table 3 too. Default: the shipped one."""
    refinement: Path | None = None
    """Joint refinement of Table 3. Default: the shipped one."""
    quick: bool = False
    """A few clips, and what takes long left out. Without --data and --files the clips are simulated for it, of
    characters and motions that are made by code.
    """
    chains: bool = False
    """Measure chains that are laid over the shape of apparel alone, on the clips for validation too."""

    def run(self) -> None:
        check_range("--clips", self.clips, 1, 10_000)
        if self.data is None and not self.files and not self.quick:
            raise OptionError("there is nothing to measure; name --data, --files, or both, or give --quick")
        networks = (self.weights, self.masks, self.refinement)
        for path in (*self.files, *self.bodies, *(p for p in networks if p is not None)):
            check_input(path)
        check_source(self.motions, "name a folder that `bunraku data motions` wrote")
        from bunraku_lab.evaluation.apparel.table import ApparelEvalConfig, evaluate_apparel

        with stages() as report:
            config = ApparelEvalConfig(
                self.data, self.motions, self.files, clips=6 if self.quick else self.clips, weights=self.weights,
                masks=self.masks, bodies=self.bodies, refinement=self.refinement, quick=self.quick,
                chains=self.chains,
            )  # fmt: skip
            result = evaluate_apparel(config, report)
        self.show(result, _report)


def _report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.apparel.table import APPAREL_BARS

    parts = [bar_table(APPAREL_BARS, result)]
    for title, table in result["tables"].items():
        columns = list(dict.fromkeys(name for row in table.values() for name in row))
        rows = [["", *columns]]
        for name, row in table.items():
            rows.append([name, *("-" if row.get(column) is None else f"{row[column]:.3f}" for column in columns)])
        parts.append(Table(rows, title=title))
    return Report(parts)
