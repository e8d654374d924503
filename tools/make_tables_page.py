"""Write docs/tables.md, the papers' tables with our figures, from what `bunraku evaluate tables --json` printed.

    bunraku evaluate tables --paper tapmo --data data/motions --characters archive --mdm MDM.safetensors --json > a.json
    bunraku evaluate tables --paper mmdmc --apparel data/apparel --json > b.json
    python tools/make_tables_page.py a.json b.json

The figures are kept beside the page (docs/tables.json), so that a test finds each of its numbers there.
"""

from __future__ import annotations

import argparse
import json
from datetime import date
from pathlib import Path

from bunraku_lab.evaluation.report import Report
from bunraku_lab.evaluation.tables.paper_table import shown_table

DOCS = Path(__file__).resolve().parents[1] / "docs"
HEAD = """# The papers' tables

TapMo's and MMDMC's tables with our figures, by `bunraku evaluate tables`, {day}. The data are not the papers', so what
compares are the ratios to the same row on both sides. A row that was not run says what it lacks. The page is made by
`tools/make_tables_page.py`.
"""


def page(tables: list[dict[str, object]], day: str) -> str:
    """The page in Markdown."""
    parts = [HEAD.format(day=day)]
    for table in tables:
        parts.append(Report(shown_table(table)).markdown())
        counts = table.get("counts")  # what it was measured on
        if isinstance(counts, dict) and counts:
            parts.append("Measured on: " + ", ".join(f"{name} {value:g}" for name, value in counts.items()) + ".")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path, help="what `bunraku evaluate tables --json` printed")
    options = parser.parse_args()
    tables = [table for path in options.results for table in json.loads(path.read_text())["tables"]]
    tables.sort(key=lambda table: (table["paper"] != "tapmo", table["number"]))
    day = date.today().isoformat()
    (DOCS / "tables.json").write_text(json.dumps({"day": day, "tables": tables}, indent=1) + "\n")
    (DOCS / "tables.md").write_text(page(tables, day))


if __name__ == "__main__":
    main()
