"""Write the pages of figures: docs/tables.md, the papers' tables, and docs/measurements.md.

    bunraku evaluate tables --paper tapmo --data data/motions --characters archive
        --baselines runs/baselines --json > a.json
    bunraku evaluate tables --paper mmdmc --apparel data/apparel --baselines runs/baselines --json > b.json
    python tools/make_tables_page.py a.json b.json
    python tools/make_tables_page.py

Tables that are not among the results stay as docs/tables.json keeps them, with their day. The last line writes both
pages again from the figures that are kept there and in docs/measurements.json, after a word has changed.
"""

from __future__ import annotations

import argparse
import json
from datetime import date
from pathlib import Path
from typing import Any

from bunraku_lab.evaluation.tables.paper_table import EITHER_WAY, NAMES, measured_table

PICTURES = {
    ("tapmo", 1): ("tables-tapmo-1.webp", "The same sentence and seed on the reference body"),
    ("tapmo", 2): ("tables-tapmo-2.webp", "The same sentence and seed on KayKit's Rogue Hooded, which no training saw"),
    ("mmdmc", 2): ("tables-mmdmc.webp", "The same dance of a character of the wardrobe, simulated and by each way"),
}
"""Of the first table of each number, made by `tools/make_tables_pictures.py`."""
CONCLUSIONS = {
    "text-based motion generation": "One sample is far nearer to real motion than TapMo (MDM); the sample that animate "
    "chooses exceeds the R-Precision of real motion.",
    "mesh distortion": "Our characters are distorted far less than with a fitted skeleton, and the adaptation helps.",
    "apparel and body in motion, ten frames from a true state": "Ours has a smaller error than both methods and, on "
    "apparel, than the best fixed skinning.",
    "apparel and body in motion, 6 s from rest": "On apparel, ours is behind the best fixed skinning "
    "and ahead of all else.",
    "modules": "With the mask that is found, the error grows, since some of the body is taken for apparel; with the "
    "true mask it falls by a quarter. Refinement helps.",
    "geodesic attention, the truth without physics": "After a minute of training, attention has the "
    "smallest error on the body only.",
}
"""One line for each table that is shown, by its title."""
DOCS = Path(__file__).resolve().parents[1] / "docs"
HEAD = """# The papers' tables

TapMo's and MMDMC's tables with our figures, printed by `bunraku evaluate tables`. A cell has the paper's figure / ours
and, in brackets, the ratios of both to the reference row. Our data differ from the papers', so only these ratios can be
compared. The value after ± is half of a 95 % interval. Rows that were not run, and rows that the papers
quote from others, are left out. `tools/make_tables_page.py` makes the page; `benchmarks/baselines.md` has the commands
for the other methods' weights.
"""
MEASUREMENTS = """# Measurements

Figures of November 2026. Below each table are the command that prints it and the date.
[How things are measured](evaluation.md) defines the measures. A bar is the target that was set before measuring. Times
are those of two cores of an AMD EPYC (Zen 5) virtual machine. `tools/make_tables_page.py` makes this page from
`docs/measurements.json`.
"""


def page(tables: list[dict[str, Any]]) -> str:
    """The page of the papers' tables in Markdown."""
    parts = [HEAD]
    pictures = dict(PICTURES)
    for table in tables:
        rows = [row for row in table["rows"] if not row["not_run"]]
        if not rows:
            continue
        parts.append(f"## {NAMES[table['paper']]}, table {table['number']}: {table['title']}")
        parts.append(CONCLUSIONS[table["title"]])
        cells = [[row["name"], *(_cell(row["cells"][column]) for column in table["columns"])] for row in rows]
        parts.append(_markdown([[f"over {table['our_reference']}", *table["columns"]], *cells]))
        counts = ", ".join(f"{name} {value:g}" for name, value in table.get("counts", {}).items() if value)
        parts.append(f"{table['note']} Measured on {table['day']}: {counts}.".strip())
        name, caption = pictures.pop((str(table["paper"]), int(table["number"])), ("", ""))
        if name:
            parts.append(f"![{caption}](pictures/{name})")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def measurements_page(sections: list[dict[str, Any]]) -> str:
    """The page of measurements in Markdown: of each table its title, one line of conclusion, and where it is from."""
    parts = [MEASUREMENTS]
    for section in sections:
        parts.append(f"## {section['title']}")
        for table in section["tables"]:
            parts += [f"**{table['title']}.** {table['conclusion']}", _markdown([table["columns"], *table["rows"]])]
            parts.append(f"`{table['command']}`, {table['date']}")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _cell(cell: dict[str, Any]) -> str:
    """Paper / ours, and both over the reference in brackets."""
    if cell["ours"] is None and cell["paper"] is None:
        return "-"
    either = "" if cell.get("interval") is None else f"{EITHER_WAY}{cell['interval']:.2g}"
    shown = "/".join("-" if cell[key] is None else f"{cell[key]:.3g}" for key in ("paper", "ours")) + either
    ratios = [cell["paper_over_reference"], cell["ours_over_reference"]]
    return f"{shown} ({'/'.join('-' if value is None else f'{value:.3g}' for value in ratios)})"


def _markdown(rows: list[list[str]]) -> str:
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"|{'|'.join(cells)}|" for cells in lines)


def kept_tables(kept: dict[str, Any]) -> list[dict[str, Any]]:
    """The kept tables with the rows, reasons and notes of the tables as they are."""
    from bunraku_lab.evaluation.tables.measured import PAPERS  # loads torch

    out = []
    for old in kept["tables"]:
        (table,) = (each for each in PAPERS[old["paper"]] if (each.number, each.title) == (old["number"], old["title"]))
        figures = {row["name"]: _figures(row["cells"]) for row in old["rows"] if not row["not_run"]}
        reasons = {row["name"]: row["not_run"] for row in old["rows"]}
        new = measured_table(table, figures)
        for row in new["rows"]:
            row["not_run"] = row["not_run"] and (reasons.get(row["name"]) or row["not_run"])
        out.append({**new, "counts": old["counts"], "day": old["day"]})
    return out


def _figures(cells: dict[str, Any]) -> dict[str, float]:
    own = {column: cell["ours"] for column, cell in cells.items()}
    own |= {f"{column} {EITHER_WAY}": cell["interval"] for column, cell in cells.items()}
    return {key: value for key, value in own.items() if value is not None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="*", type=Path, help="what `bunraku evaluate tables --json` printed")
    options = parser.parse_args()
    tables = kept_tables(json.loads((DOCS / "tables.json").read_text()))
    for path in options.results:
        for new in json.loads(path.read_text())["tables"]:
            same = [table["paper"] == new["paper"] and table["title"] == new["title"] for table in tables]
            tables[same.index(True)] = {**new, "day": date.today().isoformat()}
    (DOCS / "tables.json").write_text(json.dumps({"tables": tables}, indent=1) + "\n")
    (DOCS / "tables.md").write_text(page(tables))
    sections = json.loads((DOCS / "measurements.json").read_text())["sections"]
    (DOCS / "measurements.md").write_text(measurements_page(sections))


if __name__ == "__main__":
    main()
