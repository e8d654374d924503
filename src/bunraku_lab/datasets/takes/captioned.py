"""A folder of motions of one's own with their captions: `bunraku data motions --source FOLDER`.

`captions.csv` has a row for each sentence:

| column | |
| --- | --- |
| `file` | the motion, a path in the folder: any file that `bunraku transfer` takes as a motion |
| `text` | what is done in it; several rows of one file are several ways to say it |
| `start`, `end` | seconds of the file that the sentence is about; all of it without them |
| `clip` | number or name of the clip of a file with several |
| `split` | "train", "val" or "test"; "train" without it |
| `licence`, `credit` | on which terms it may be learned from, and whom to name: the cards of weights carry them |
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from bunraku.diffusion.examples.pack import OWN
from bunraku.errors import FormatError
from bunraku_lab.datasets.takes.takes import Take

__all__ = ["CAPTIONS", "own_takes"]

CAPTIONS = "captions.csv"
"""The file of the captions, in the folder of the motions."""
MOST_ROWS = 100_000
MOST_WORDS = 1_000
"""Letters of one sentence."""
_SPLITS = ("train", "val", "test")


def own_takes(folder: str | Path) -> list[Take]:
    """What the rows of `captions.csv` say of the motions beside it.

    Rows about the same seconds of the same file are one take with several sentences, the fullest first.

    Raises:
        FormatError: There is no such file, a column is missing, or a row cannot be followed; the row is named.
    """
    folder = Path(folder)
    path = folder / CAPTIONS
    if not path.is_file():
        raise FormatError(path, "there is no such file; write one with the columns file and text beside the motions")
    found: dict[tuple[object, ...], tuple[Take, list[str]]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            if not {"file", "text"} <= set(rows.fieldnames or ()):
                raise FormatError(path, "its first line must name the columns file and text, parted by commas")
            for row in rows:
                if rows.line_num > MOST_ROWS:
                    raise FormatError(path, f"it has more than {MOST_ROWS} lines; take several folders")
                take = _take(path, row, rows.line_num)
                key = (take.file, take.clip, take.start, take.end)
                found.setdefault(key, (take, []))[1].extend(take.texts)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(path, f"it cannot be read ({error}); save it as CSV in UTF-8") from error
    if not found:
        raise FormatError(path, "it has no rows; write one for each sentence")
    return [
        replace(
            take, texts=tuple(sorted(dict.fromkeys(texts), key=lambda text: -len(text.split())))
        )  # the fullest first
        for take, texts in found.values()
    ]


def _take(path: Path, row: Mapping[str | None, str | None], line: int) -> Take:
    cells = {name: (value or "").strip() for name, value in row.items() if name and isinstance(value, str)}
    name, text = cells.get("file", ""), " ".join(cells.get("text", "").split())
    if not name or not text:
        raise FormatError(path, f"line {line}: the {'text' if name else 'file'} is missing")
    if len(text) > MOST_WORDS:
        raise FormatError(path, f"line {line}: the text has more than {MOST_WORDS} letters; say it shorter")
    root = path.parent.resolve()
    file = (root / name.replace("\\", "/")).resolve()
    if not file.is_relative_to(root):
        raise FormatError(path, f"line {line}: {name} leads out of the folder; copy the motion into it")
    if not file.exists():
        raise FormatError(path, f"line {line}: there is no file {name} in the folder")
    start, end = (_seconds(path, cells.get(column, ""), line) for column in ("start", "end"))
    if end is not None and end <= (start or 0.0):
        raise FormatError(path, f"line {line}: the end must come after the start")
    split = cells.get("split", "") or "train"
    if split not in _SPLITS:
        raise FormatError(path, f"line {line}: the split is '{split[:20]}'; write train, val or test")
    clip = cells.get("clip", "")
    licence = cells.get("licence", "") or cells.get("license", "") or "as the owner's"
    return Take(
        _name(name, clip, start, end), file, (text,), split, f"own, {name}", start or 0.0, end,
        int(clip) if clip.isdecimal() else clip or 0, licence, cells.get("credit", ""), True,
    )  # fmt: skip


def _seconds(path: Path, text: str, line: int) -> float | None:
    try:
        value = float(text) if text else None
    except ValueError:
        value = math.nan
    if value is not None and not 0 <= value < 1e6:
        raise FormatError(path, f"line {line}: '{text[:20]}' is no time in seconds")
    return value


def _name(name: str, clip: str, start: float | None, end: float | None) -> str:
    """A plain name for a take, by what it is cut from, so that other cuts of a file are other clips."""
    parts = [Path(name).with_suffix("").as_posix(), clip]
    parts += [f"{seconds:.2f}" for seconds in (start, end) if seconds is not None]
    return OWN + re.sub(r"[^A-Za-z0-9]+", "_", "_".join(filter(None, parts))).strip("_")
