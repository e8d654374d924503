"""What is known of training clips: where they come from (weight, credit, licence), and their captions by time."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from bunraku.errors import FormatError

__all__ = [
    "Source",
    "Stretch",
    "credit_lines",
    "load_watched",
    "source_of",
    "subject_of",
]


_CUT = "turn_"
"""How the names of clips begin that were cut out of others (`turns`)."""


@dataclass(frozen=True)
class Source:
    """One source of clips.

    Args:
        prefixes: How the names of its clips begin.
        credit: Whom to name.
        licence: On which terms.
        weight: How often its clips are drawn, 1 for most; less where a toy's or a robot's proportions make feet slide,
            or where there is much of the same.
        subject_parts: Parts of a name, between underscores, that tell the captured subject; None for two parts without
            the number at their end.
        holds_ends: Its takes begin and end in a pose that is held, which is no part of what their captions say.
    """

    prefixes: tuple[str, ...]
    credit: str
    licence: str
    weight: float = 1.0
    subject_parts: int | None = None
    holds_ends: bool = False

    @property
    def credit_line(self) -> str:
        """A line of a model card's credits."""
        return f"{self.credit}. Licence: {self.licence}."


@functools.cache
def _table() -> tuple[Source, ...]:
    text = resources.files("bunraku_lab.datasets.motions").joinpath("sources.json").read_text(encoding="utf-8")
    return tuple(Source(**{**entry, "prefixes": tuple(entry["prefixes"])}) for entry in json.loads(text)["sources"])


def source_of(name: str) -> Source | None:
    """The source of a clip, that of the longest prefix; None where the table does not know it."""
    found = [
        (len(prefix), source)
        for source in _table()
        for prefix in source.prefixes
        if name.removeprefix(_CUT).startswith(prefix)
    ]
    return max(found, key=lambda pair: pair[0])[1] if found else None


def subject_of(name: str) -> str:
    """The captured subject of a clip, as its name tells: `cmu_16_11` -> `cmu_16`, `accad_m1_Walk2` -> `accad_m1`,
    `snu_WalkSad05` -> `snu_WalkSad`.
    """
    source = source_of(name)
    if source is not None and source.subject_parts is not None:
        return "_".join(name.split("_")[: source.subject_parts])
    return "_".join(name.split("_")[:2]).rstrip("0123456789")


def credit_lines(names: Iterable[str]) -> list[str]:
    """Whom to name for these clips, each source once, in the order of the table."""
    used = {source for source in map(source_of, names) if source is not None}
    return list(dict.fromkeys(source.credit_line for source in _table() if source in used))


NAME = "captions_watched.json"
FEWEST = 8
"""Frames of the shortest stretch that is kept."""
_SPACES = re.compile(r"\s+")


@dataclass(frozen=True)
class Stretch:
    """A part of a clip and what it shows.

    Args:
        start: First frame.
        stop: Frame after the last.
        texts: Sentences, the fullest first, the tersest last.
        fault: Why it is not to be trained on; None where it is.
        note: What the watcher noticed.
    """

    start: int
    stop: int
    texts: tuple[str, ...]
    fault: str | None = None
    note: str = ""


def plain(sentence: str) -> str:
    """A sentence in lower case at its start, with single spaces and no full stop, as people type."""
    sentence = _SPACES.sub(" ", sentence).strip().rstrip(". ")
    return sentence[:1].lower() + sentence[1:]


def load_watched(folder: str | Path, frames: dict[str, int], fps: float = 20.0) -> dict[str, list[Stretch]]:
    """Stretches of each clip; nothing where the folder has no `captions_watched.json`.

    Args:
        folder: Of the archive.
        frames: Length of each clip by its name.
        fps: Frames a second [1/s].

    Raises:
        FormatError: The file is damaged.
    """
    path = Path(folder) / NAME
    if not path.is_file():
        return {}
    try:
        table: dict[str, list[dict[str, Any]]] = json.loads(path.read_text(encoding="utf-8"))["clips"]
        found: dict[str, list[Stretch]] = {}
        for name, rows in table.items():
            if name not in frames:
                continue
            for row in rows:
                start, stop = round(float(row["start"]) * fps), min(round(float(row["end"]) * fps), frames[name])
                texts = tuple(dict.fromkeys(plain(str(text)) for text in row["texts"] if str(text).strip()))
                note = str(row.get("note") or "")
                if stop - start < FEWEST or not texts:
                    continue
                fault = None if row.get("ok", True) else f"watched: {note or 'broken'}"
                found.setdefault(name, []).append(Stretch(max(start, 0), stop, texts, fault, note))
        return found
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            path, f"cannot be read as captions by time ({type(error).__name__}); copy it again or take it away"
        ) from error
