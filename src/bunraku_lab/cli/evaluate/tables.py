"""`bunraku evaluate tables`: the papers' tables, theirs and ours side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from bunraku.cli.output.checks import check_folder, check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report

__all__ = ["EvaluateTables"]


@dataclass(frozen=True)
class EvaluateTables(Printed):
    """Measure every row of a paper's tables that can be measured here, beside the paper's own figures.

    Ratios are to the same row on both sides, since the data are others. What is not run says what it lacks. Rows are
    kept in --work by what they depend on, so a second run, or one that was stopped, does only what is new.

    Example: bunraku evaluate tables --paper tapmo --table 2 --characters archive
    --baselines benchmarks/weights
    """

    paper: Literal["tapmo", "mmdmc"] = "tapmo"
    """Whose tables."""
    table: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Number of one table. Default: all."""
    data: Path | None = None
    """Folder that `bunraku data motions` wrote."""
    characters: Path | None = None
    """Folder of rigged characters, searched through."""
    apparel: Path | None = None
    """Folder that `bunraku data apparel` wrote; with --quick some clips are simulated without it."""
    bodies: tuple[Path, ...] = ()
    """Body networks of MMDMC's table 4. Default: the shipped one, and those of --baselines."""
    baselines: Path | None = None
    """Folder of the other methods' weights (benchmarks/weights of the repository); without it their rows are left
    out. Their trainings are named beside them."""
    work: Path = Path("runs/tables")
    """Folder that keeps what was measured."""
    quick: bool = False
    """On few windows, characters and clips."""
    pool: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Windows of TapMo's table 1, 4 to 100000. Default: 1600, or 96 with --quick."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        for path in self.bodies:
            check_input(path)
        check_source(self.data, "name the folder that `bunraku data motions` wrote")
        check_source(self.characters, "name a folder of rigged characters")
        check_source(self.baselines, "name a folder of weights")
        check_source(self.apparel, "name the folder that `bunraku data apparel` wrote")
        check_folder(self.work)
        check_range("--pool", self.pool, 4, 100_000)
        from bunraku_lab.evaluation.tables.measured import TablesConfig, measure_tables

        config = TablesConfig(
            self.paper, self.table, self.data, self.characters, self.apparel, self.bodies,
            self.baselines, self.work, self.quick, self.pool,
            self.seed,
        )  # fmt: skip
        with stages() as report:
            found = measure_tables(config, report)
        self.show({"tables": found}, _report)


def _report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.tables.paper_table import shown_table

    return Report([part for table in result["tables"] for part in shown_table(table)])
