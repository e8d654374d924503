"""What another method is asked to make: a table for programs, whose results come back as files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from bunraku.formats.files import atomic_write

__all__ = ["write_asked"]


def write_asked(path: str | Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    """Write a CSV, whole or not at all.

    Raises:
        FormatError: The file cannot be written.
    """
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow(columns)
    table.writerows(rows)
    with atomic_write(Path(path)) as file:
        file.write(out.getvalue().encode())
    return Path(path)
