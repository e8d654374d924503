"""How the evaluations print what they found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku_lab.evaluation.report import Report

__all__ = ["Printed"]


@dataclass(frozen=True, kw_only=True)
class Printed:
    """The options that all evaluations have for what they print."""

    json: bool = False
    """Print JSON for programs, with all that was measured."""
    markdown: bool = False
    """Print the tables as Markdown, for a page."""

    def __post_init__(self) -> None:
        if self.json and self.markdown:
            raise OptionError("--json and --markdown are two forms of the same report; choose one")

    def show(self, result: dict[str, Any], report: Callable[[dict[str, Any]], Report]) -> None:
        """Print a result in the requested form."""
        if self.json:
            print(json.dumps(result, indent=2))
        else:
            made = report(result)
            print(made.markdown() if self.markdown else made.text())
