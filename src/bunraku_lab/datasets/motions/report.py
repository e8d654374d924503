"""What the training motions show, action by action: `bunraku data motions --report`.

A row of the table is what somebody wants to know before hours of training: how much there is of an action, how far it
turns, how fast it goes, how low the body comes, how long feet stand, and what was left out and why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.geometry.rotations import heading
from bunraku.language.description.track import Track
from bunraku.language.lexicon.reading import main_actions
from bunraku_lab.datasets.motions.clips import load_clip, load_index, load_lowest

__all__ = ["ActionRow", "motion_report", "report_text"]

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
