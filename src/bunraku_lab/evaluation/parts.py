"""Parts of a long measurement that are kept one by one, so that one that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.formats.files import atomic_write

__all__ = ["KeptParts", "Parts", "at_once"]

Parts = Callable[[str, Callable[[], Any]], Any]
"""Gives what a function measures, by the name of the part; JSON can say it."""


def at_once(name: str, measure: Callable[[], Any]) -> Any:
    """Measure, and keep nothing."""
    return measure()


@dataclass(frozen=True)
class KeptParts:
    """What was measured before, or is measured now and kept.

    Args:
        folder: That keeps it, of one measurement with all that it depends on.
    """

    folder: Path

    def __call__(self, name: str, measure: Callable[[], Any]) -> Any:
        """Give a part.

        Args:
            name: Of the part in this measurement.
            measure: Called where it is not known yet.
        """
        path = self.folder / f"{hashlib.sha256(name.encode()).hexdigest()[:24]}.json"
        if path.is_file():
            return json.loads(path.read_text(encoding="utf-8"))
        text = json.dumps(measure())
        self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(text.encode())
        return json.loads(text)
