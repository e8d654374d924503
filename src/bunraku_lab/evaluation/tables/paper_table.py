"""A table of a paper beside what is measured here: its rows, its columns, and what was not run."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bunraku import __version__
from bunraku.core.files import atomic_write
from bunraku.errors import BunrakuError
from bunraku_lab.evaluation.report import KeptParts, Parts, Table

NAMES = {"tapmo": "TapMo", "mmdmc": "MMDMC"}
Figures = Mapping[str, Mapping[str, float]]
"""Of each row, by the names of the columns; half a 95 % interval stands under the name with `EITHER_WAY`."""
EITHER_WAY = "±"


class NotRun(BunrakuError):
    """What a group of rows lacks to be measured; its sentence says what to give."""


@dataclass(frozen=True)
class PaperRow:
    """A method.

    Args:
        name: As the paper calls it, or as we call ours.
        paper: The paper's figures, in the order of the columns; None where it has no such row or figure.
        missing: Why it cannot be measured here, where it never is.
    """

    name: str
    paper: Sequence[float | None] | None = None
    missing: str = ""


@dataclass(frozen=True)
class PaperTable:
    """A table.

    Args:
        paper: "tapmo" or "mmdmc".
        number: Of the table in the paper.
        title: What it compares.
        columns: Names, with their unit.
        rows: Methods.
        reference: The row that the ratios are to.
        note: What the table cannot say.
        part: Tells tables that stand under one number, "" where there is one.
        stand_in: The row that our ratios are to where the reference is not measured here.
    """

    paper: str
    number: int
    title: str
    columns: Sequence[str]
    rows: Sequence[PaperRow]
    reference: str
    note: str = ""
    part: str = ""
    stand_in: str = ""

    @property
    def key(self) -> str:
        """What tells it from the paper's other tables."""
        return f"{self.number} {self.part}".strip()


@dataclass(frozen=True)
class Group:
    """Rows that are measured together.

    Args:
        name: Plain, for the file that keeps them.
        run: Measures them, part by part. It raises `NotRun` where something is not there.
        of: What the figures depend on beside the version: settings, and files whose bytes count.
        others: The same of single rows, whose parts are distinguished by their own names: where these change, the
            other parts stay. None where no row stands apart.
    """

    name: str
    run: Callable[[Parts], Figures]
    of: Mapping[str, Any] = field(default_factory=dict)
    others: Mapping[str, Any] | None = None

    def figures(self, work: Path) -> Figures:
        """What was measured before of the same, or is measured now and kept."""
        kept = work / f"{self.name}-{_fingerprint({**self.of, **(self.others or {})})}.json"
        if kept.is_file():
            found: Figures = json.loads(kept.read_text(encoding="utf-8"))
            return found
        parts = work / f"{self.name}-{_fingerprint(self.of)}"
        measured = {row: dict(values) for row, values in self.run(KeptParts(parts)).items()}
        work.mkdir(parents=True, exist_ok=True)
        with atomic_write(kept) as file:
            file.write(json.dumps(measured, indent=1).encode())
        if self.others is None:
            shutil.rmtree(parts, ignore_errors=True)  # the whole is known
        return measured


def _fingerprint(of: Mapping[str, Any]) -> str:
    """What tells the version, some settings and files from others."""
    seen = hashlib.sha256(__version__.encode())
    for key, value in sorted(of.items()):
        seen.update(key.encode())
        path = value if isinstance(value, Path) else None
        if path is not None and path.is_file():
            with path.open("rb") as file:
                seen.update(hashlib.file_digest(file, "sha256").digest())
        else:
            seen.update(str(value).encode())
    return seen.hexdigest()[:16]


def half_interval(values: Sequence[float]) -> float:
    """Half of the 95 % interval of a mean over characters, by their standard error; 0 of a single one."""
    count = len(values)
    return 0.0 if count < 2 else 1.96 * float(np.std(values, ddof=1)) / count**0.5


def measured_table(table: PaperTable, figures: Figures, not_run: str = "") -> dict[str, Any]:
    """A table for JSON: in each row and column the paper's figure, ours, and both over the reference row's."""
    paper_of = {row.name: row.paper for row in table.rows}
    own_reference = table.reference if table.reference in figures or not table.stand_in else table.stand_in
    rows = []
    for row in table.rows:
        cells = {}
        for index, column in enumerate(table.columns):
            said = None if row.paper is None else row.paper[index]
            own = figures.get(row.name, {}).get(column)
            base = paper_of.get(table.reference)
            cells[column] = {
                "paper": said, "ours": own, "interval": figures.get(row.name, {}).get(f"{column} {EITHER_WAY}"),
                "paper_over_reference": _over(said, None if base is None else base[index]),
                "ours_over_reference": _over(own, figures.get(own_reference, {}).get(column)),
            }  # fmt: skip
        reason = "" if row.name in figures else row.missing or not_run or "its group measured no such row"
        rows.append({"name": row.name, "cells": cells, "not_run": reason})
    return {
        "paper": table.paper, "number": table.number, "title": table.title, "reference": table.reference,
        "our_reference": own_reference,
        "columns": list(table.columns), "rows": rows, "note": table.note,
    }  # fmt: skip


def _over(value: float | None, base: float | None) -> float | None:
    return value / base if value is not None and base else None


def shown_table(measured: Mapping[str, Any]) -> list[Table | str]:
    """A measured table with the paper's figure before ours, and a line for each reason why rows were not run."""
    rows = [["paper / ours", *(cell for column in measured["columns"] for cell in (column, "ratio"))]]
    for row in measured["rows"]:
        cells = [row["cells"][column] for column in measured["columns"]]
        shown = [(cell["paper"], cell["ours"], cell.get("interval")) for cell in cells]
        ratios = [(cell["paper_over_reference"], cell["ours_over_reference"], None) for cell in cells]
        rows.append([row["name"], *(_pair(*pair) for both in zip(shown, ratios, strict=True) for pair in both)])
    title = f"{NAMES[measured['paper']]}, table {measured['number']}: {measured['title']}"
    to = measured["reference"]
    if measured.get("our_reference", to) != to:
        to += f", ours to {measured['our_reference']}"
    parts: list[Table | str] = [Table(rows, title=f"{title} (ratios to {to})")]
    reasons: dict[str, list[str]] = {}
    for row in measured["rows"]:
        if row["not_run"]:
            reasons.setdefault(row["not_run"], []).append(row["name"])
    parts += [f"not run: {', '.join(names)}: {reason}" for reason, names in reasons.items()]
    return parts + ([measured["note"]] if measured["note"] else [])


def _pair(paper: float | None, ours: float | None, interval: float | None) -> str:
    if paper is None and ours is None:
        return "-"
    either = "" if interval is None else f" {EITHER_WAY} {interval:.2g}"
    return " / ".join("-" if value is None else f"{value:.3g}" for value in (paper, ours)) + either
