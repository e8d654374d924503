"""What a verb says on standard output when it is done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["measured", "size_text", "wrote"]


def wrote(path: Path, note: str = "") -> None:
    """Print a line that names a file, or the folder of a sequence, and its size."""
    files = [path] if path.is_file() else sorted(file for file in path.glob("*") if file.is_file())
    size = size_text(sum(file.stat().st_size for file in files))
    count = "" if path.is_file() else f"{len(files)} files, "
    print(f"wrote {path} ({count}{size}{', ' + note if note else ''})")


def size_text(size: int) -> str:
    """A number of bytes for people: 1536 -> "1.5 kB"."""
    value = float(size)
    for unit in ("bytes", "kB", "MB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "bytes" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"


def measured(result: dict[str, Any], as_json: bool, table: Callable[[dict[str, Any]], None]) -> None:
    """Print what was measured, as JSON for programs or by `table` for people."""
    if as_json:
        import json

        print(json.dumps(result, indent=2))
    else:
        table(result)
