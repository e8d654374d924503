"""Write docs/tables.md, the papers' tables with our figures, from what `bunraku evaluate tables --json` printed.

    bunraku evaluate tables --paper tapmo --data data/motions --characters archive
        --baselines benchmarks/weights --json > a.json
    bunraku evaluate tables --paper mmdmc --apparel data/apparel --baselines benchmarks/weights --json > b.json
    python tools/make_tables_page.py a.json b.json
    python tools/make_tables_page.py

The last line writes it anew from the figures that are kept, after a word of the tables has changed: rows that are new
are not run, and the day stays.

The figures are kept beside the page (docs/tables.json), so that a test finds each of its numbers there.
"""

from __future__ import annotations

import argparse
import json
from datetime import date
from pathlib import Path
from typing import Any

from bunraku_lab.evaluation.report import Report
from bunraku_lab.evaluation.tables.measured import PAPERS
from bunraku_lab.evaluation.tables.paper_table import EITHER_WAY, measured_table, shown_table

PICTURES = {
    ("tapmo", 1): ("tables-tapmo-1.png", "The same sentence and seed on the reference body"),
    ("tapmo", 2): ("tables-tapmo-2.png", "The same sentence and seed on Rogue Hooded of KayKit, which no training saw"),
    ("mmdmc", 2): ("tables-mmdmc.png", "The same dance of a character of the wardrobe, simulated and by each way"),
}
"""Of the first table of each number, made by `tools/make_tables_pictures.py`."""
DOCS = Path(__file__).resolve().parents[1] / "docs"
HEAD = """# The papers' tables

TapMo's and MMDMC's tables with our figures, by `bunraku evaluate tables`, {day}. The data are not the papers', so what
compares are the ratios to the same row on both sides. What stands after ± is half of a 95 % interval, in TapMo's table
1 over the runs and elsewhere over characters. A row that was not run says what it lacks. The page is made by
`tools/make_tables_page.py`, the other methods' weights by the commands in `benchmarks/weights/baselines.md`.
"""


def page(tables: list[dict[str, object]], day: str) -> str:
    """The page in Markdown."""
    parts = [HEAD.format(day=day)]
    pictured = dict(PICTURES)
    for table in tables:
        parts.append(Report(shown_table(table)).markdown())
        name, said = pictured.pop((str(table["paper"]), int(str(table["number"]))), ("", ""))
        if name:
            parts.append(f"![{said}](pictures/{name})")
        counts = table.get("counts")  # what it was measured on
        if isinstance(counts, dict) and counts:
            parts.append("Measured on: " + ", ".join(f"{name} {value:g}" for name, value in counts.items()) + ".")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def kept_tables(told: dict[str, Any]) -> list[dict[str, Any]]:
    """The kept tables with the rows, reasons and notes of the tables as they are."""
    out = []
    for old in told["tables"]:
        (table,) = (one for one in PAPERS[old["paper"]] if (one.number, one.title) == (old["number"], old["title"]))
        figures = {row["name"]: _figures(row["cells"]) for row in old["rows"] if not row["not_run"]}
        reasons = {row["name"]: row["not_run"] for row in old["rows"]}
        new = measured_table(table, figures)
        for row in new["rows"]:
            row["not_run"] = row["not_run"] and (reasons.get(row["name"]) or row["not_run"])
        out.append({**new, "counts": old["counts"]})
    return out


def _figures(cells: dict[str, Any]) -> dict[str, float]:
    own = {column: cell["ours"] for column, cell in cells.items()}
    own |= {f"{column} {EITHER_WAY}": cell["interval"] for column, cell in cells.items()}
    return {key: value for key, value in own.items() if value is not None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="*", type=Path, help="what `bunraku evaluate tables --json` printed")
    options = parser.parse_args()
    tables = [table for path in options.results for table in json.loads(path.read_text())["tables"]]
    day = date.today().isoformat()
    if not tables:
        told = json.loads((DOCS / "tables.json").read_text())
        tables, day = kept_tables(told), told["day"]
    tables.sort(key=lambda table: (table["paper"] != "tapmo", table["number"]))
    (DOCS / "tables.json").write_text(json.dumps({"day": day, "tables": tables}, indent=1) + "\n")
    (DOCS / "tables.md").write_text(page(tables, day))


if __name__ == "__main__":
    main()
