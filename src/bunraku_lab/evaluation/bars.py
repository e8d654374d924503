"""The tables of all evaluations: figures, what each should reach, and how they are printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Bar", "bar_lines", "figure", "measured_in", "percent", "reached_bars", "table_lines"]


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
    """A figure of a table and the values that it should lie between; without either it is only told.

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


def table_lines(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """A table as lines, the first row its head, with columns as wide as what is in them.

    Args:
        rows: Cells.
        left: How many columns begin at the left; so do the cells of a last one that has words.
    """
    last = len(rows[0]) - 1
    words = {last} if any(cell.isalpha() for *_, cell in rows[1:]) else set()
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if column < left or column in words else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def bar_lines(
    bars: Mapping[str, Bar],
    result: Mapping[str, Any],
    title: str = "measure",
    reached: Mapping[str, bool | None] | None = None,
) -> list[str]:
    """Figures beside their bars, as lines.

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
    return table_lines(rows)
