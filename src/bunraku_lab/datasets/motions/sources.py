"""What is known of training clips: where they come from (weight, credit, licence), their captions by time, and what
they show, action by action.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.geometry.rotations import heading
from bunraku.errors import FormatError
from bunraku.generation.agreement import Track
from bunraku.language.lexicon import main_actions
from bunraku_lab.datasets.motions.clips import load_clip, load_index, load_lowest

__all__ = [
    "ActionRow",
    "Source",
    "Stretch",
    "credit_lines",
    "load_watched",
    "motion_report",
    "report_text",
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


NEAR, SLOW = 0.06, 0.35
"""A foot stands where it is this near to the ground [m] and this slow [m/s]."""


@dataclass
class ActionRow:
    """Figures of one action, a value for each stretch that shows it.

    Args:
        seconds: Length [s].
        turn: Change of heading from start to end, positive to the left [degrees].
        speed: Mean speed of the root over the ground [m/s].
        height: Lowest place of the root against standing [m].
        contact: Share of frames in which a foot stands.
        floating: Share of frames in which nothing is within 8 cm of the ground.
        dropped: Reasons why stretches were left out, with how often.
    """

    seconds: list[float] = field(default_factory=list)
    turn: list[float] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)
    height: list[float] = field(default_factory=list)
    contact: list[float] = field(default_factory=list)
    floating: list[float] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)


def motion_report(folder: str | Path, progress: Callable[[str, float], None] | None = None) -> dict[str, ActionRow]:
    """Rows by action, people's clips only; a stretch that shows two actions counts for both.

    Args:
        folder: What `bunraku data motions` wrote.
        progress: Called with a stage's name and the share done.

    Raises:
        FormatError: The index or a clip is missing or damaged.
    """
    folder = Path(folder)
    index = {name: entry for name, entry in load_index(folder).items() if not entry.get("species")}
    rows: dict[str, ActionRow] = {}
    for done, (name, entry) in enumerate(sorted(index.items()), 1):
        parts = _parts(entry)
        if any("fault" not in part for part in parts):
            motion, lowest = load_clip(folder / f"{name}.npz"), load_lowest(folder / f"{name}.npz")
            track, angle = Track.of(motion), np.degrees(heading(motion.root_rotation, motion.fps))
            stands = _stands(track)
        for part in parts:
            for action in main_actions(part["texts"]):
                row = rows.setdefault(action, ActionRow())
                if "fault" in part:
                    reason = str(part["fault"])
                    row.dropped[reason] = row.dropped.get(reason, 0) + 1
                    continue
                cut = slice(int(part["start"]), int(part["stop"]))
                row.seconds.append((cut.stop - cut.start) / motion.fps)
                row.turn.append(float(angle[cut][-1] - angle[cut][0]))
                row.speed.append(float(track.speed[cut].mean()))
                row.height.append(float(motion.root_translation[cut, 1].min()))
                row.contact.append(float(stands[cut].mean()))
                row.floating.append(float((lowest[cut] > 0.08).mean()))
        if progress is not None:
            progress("measuring clips", done / len(index))
    return rows


def _parts(entry: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Stretches of a clip; a clip without captions by time is one."""
    if "stretches" in entry:
        return list(entry["stretches"])
    texts = entry.get("texts") or []
    return [{"start": 0, "stop": int(entry["frames"]), "texts": texts}] if texts else []


def _stands(track: Track) -> np.ndarray:
    """Frames in which a foot is on the ground and does not move, shape (N,), bool."""
    found = np.zeros(len(track), bool)
    for index, side in enumerate(("left", "right")):
        step = np.gradient(track.points[f"{side}_ankle"], axis=0) if len(track) > 1 else np.zeros((1, 3))
        found |= (track.feet[:, index] < NEAR) & (np.linalg.norm(step, axis=1) * track.fps < SLOW)
    return found


def report_text(rows: Mapping[str, ActionRow]) -> str:
    """The table as text, the most frequent action first, then what was dropped."""
    head = (
        f"{'action':<16}{'clips':>6}{'min':>7}{'turn':>7}{'90 %':>7}{'m/s':>6}{'low cm':>8}{'stands':>8}{'floats':>8}"
    )
    lines = [head, "-" * len(head)]
    for action, row in sorted(rows.items(), key=lambda item: -sum(item[1].seconds)):
        if not row.seconds:
            continue
        turn = np.abs(row.turn)
        lines.append(
            f"{action:<16}{len(row.seconds):>6}{sum(row.seconds) / 60:>7.1f}{np.median(turn):>7.0f}"
            f"{np.quantile(turn, 0.9):>7.0f}{np.mean(row.speed):>6.2f}{100 * np.median(row.height):>8.0f}"
            f"{100 * np.mean(row.contact):>7.0f}%{100 * np.mean(row.floating):>7.0f}%"
        )
    reasons = {(action, reason): count for action, row in sorted(rows.items()) for reason, count in row.dropped.items()}
    if reasons:
        lines += ["", "dropped:"]
        lines += [f"{count:>4} {action}: {reason}" for (action, reason), count in reasons.items()]
    return "\n".join(lines)
