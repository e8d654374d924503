"""What evaluations share: figures beside their bars as text or Markdown, and kept parts of a long measurement."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.core.files import atomic_write, writing


def figure(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}"


def percent(digits: int) -> Callable[[float], str]:
    """How a share is written as a percentage."""
    return lambda value: f"{value:.{digits}%}"


def measured_in(unit: str, digits: int) -> Callable[[float], str]:
    """How a figure with a unit is written."""
    return lambda value: f"{value:.{digits}f}{unit}"


@dataclass(frozen=True)
class Bar:
    """A figure of a table and the values that it should lie between; without either it is only shown.

    Args:
        title: What it is.
        least: The lowest value, None for none.
        most: The highest value, None for none.
        show: How a value is written.
        show_limit: How a bar is written; None for as a value.
    """

    title: str
    least: float | None = None
    most: float | None = None
    show: Callable[[float], str] = figure
    show_limit: Callable[[float], str] | None = None

    @property
    def bar(self) -> float | None:
        """The one value to reach; None where there is none."""
        return self.least if self.most is None else self.most

    @property
    def limit(self) -> str:
        """The bar in signs: ">= 0.7", "<= 3", "60..130"; empty without one."""
        write = self.show_limit or self.show
        if self.least is not None and self.most is not None:
            return f"{write(self.least)}..{write(self.most)}"
        if self.least is not None:
            return f">= {write(self.least)}"
        return "" if self.most is None else f"<= {write(self.most)}"

    def reached(self, value: float | None) -> bool | None:
        """Whether a figure meets the bar; None where there is no bar or no figure."""
        if value is None or (self.least is None and self.most is None):
            return None
        return bool((self.least is None or value >= self.least) and (self.most is None or value <= self.most))


def reached_bars(bars: Mapping[str, Bar], result: Mapping[str, Any]) -> dict[str, bool | None]:
    """Whether each figure with a bar meets it, by the keys of the bars; None where there is no figure."""
    return {key: bar.reached(result.get(key)) for key, bar in bars.items() if bar.bar is not None}


@dataclass(frozen=True)
class Table:
    """Rows of cells under a head.

    Args:
        rows: Cells as they are shown, the first row the head; all of the same length.
        left: How many columns begin at the left; so does a last one that has words.
        title: What the table is of, empty for nothing.
    """

    rows: Sequence[Sequence[str]]
    left: int = 1
    title: str = ""

    @property
    def to_the_left(self) -> list[bool]:
        """Whether each column begins at the left."""
        last = len(self.rows[0]) - 1
        words = any(cell.isalpha() for *_, cell in self.rows[1:])
        return [column < self.left or (column == last and words) for column in range(last + 1)]

    def text(self) -> str:
        """Lines with columns as wide as what is in them."""
        widths = [max(len(row[column]) for row in self.rows) for column in range(len(self.rows[0]))]
        lines = [
            "  ".join(
                cell.ljust(width) if left else cell.rjust(width)
                for cell, width, left in zip(row, widths, self.to_the_left, strict=True)
            ).rstrip()
            for row in self.rows
        ]
        return "\n".join([self.title, *lines] if self.title else lines)

    def markdown(self) -> str:
        """A table of GitHub's Markdown; numbers stand at the right."""
        rule = ["---" if left else "---:" for left in self.to_the_left]
        head, *rows = [[cell.replace("|", "\\|") for cell in row] for row in self.rows]
        lines = [f"| {' | '.join(row)} |" for row in (head, rule, *rows)]
        return "\n".join([f"**{self.title}**", "", *lines] if self.title else lines)


@dataclass(frozen=True)
class Report:
    """What an evaluation found, in the order of its parts: tables, and sentences of one line each."""

    parts: Sequence[Table | str]

    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(part if isinstance(part, str) else part.text() for part in self.parts)

    def markdown(self) -> str:
        """For a page."""
        return "\n\n".join(part if isinstance(part, str) else part.markdown() for part in self.parts)


def bar_table(
    bars: Mapping[str, Bar], result: Mapping[str, Any], title: str = "measure",
    reached: Mapping[str, bool | None] | None = None,
) -> Table:  # fmt: skip
    """Figures beside their bars.

    Args:
        bars: The rows.
        result: Figures by the keys of the bars.
        title: Of the first column.
        reached: What is said of the bars, where more than the figure decides; None lets the figure decide.
    """
    rows = [(title, "value", "bar", "reached")]
    for key, bar in bars.items():
        value = result.get(key)
        met = bar.reached(value) if reached is None else reached.get(key)
        shown = "-" if value is None else bar.show(value)
        rows.append((bar.title, shown, bar.limit, "" if met is None else "yes" if met else "no"))
    return Table(rows)


Parts = Callable[[str, Callable[[], Any]], Any]
"""Gives what a function measures, by the name of the part; JSON can say it."""


def at_once(name: str, measure: Callable[[], Any]) -> Any:
    """Measure, and keep nothing."""
    return measure()


@dataclass(frozen=True)
class KeptParts:
    """What was measured before, or is measured now and kept."""

    folder: Path

    def __call__(self, name: str, measure: Callable[[], Any]) -> Any:
        """Give a part."""
        found = self.known(name)
        return self.keep(name, measure()) if found is None else found

    def known(self, name: str) -> Any:
        """What was kept of a part; None where nothing was."""
        path = self._path(name)
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None

    def keep(self, name: str, value: Any) -> Any:
        """Keep what was measured, and give it as it comes back."""
        text = json.dumps(value)
        with writing(self.folder, "folder"):
            self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(self._path(name)) as file:
            file.write(text.encode())
        return json.loads(text)

    def _path(self, name: str) -> Path:
        return self.folder / f"{hashlib.sha256(name.encode()).hexdigest()[:24]}.json"
