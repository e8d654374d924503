"""Captions by time: `captions_watched.json`, written from watching each stretch of each clip.

Labels of whole takes are often wrong for their parts. Where the file lies beside the archive, its sentences take the
labels' place.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.errors import FormatError

__all__ = ["Stretch", "load_watched"]

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
