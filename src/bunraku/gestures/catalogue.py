"""All gestures, read from `gestures.toml`, which says how they are written."""

from __future__ import annotations

import functools
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bunraku.errors import FormatError
from bunraku.gestures.flow import STEP, foot_on, through
from bunraku.gestures.pose import Foot, Gesture, Hand, Key, Pose, Repeat, again, moved

__all__ = ["STANDING", "gesture_of", "gestures", "read_gestures", "gesture_row", "hand_row", "pose_row", "read_parts"]

FILE = Path(__file__).with_name("gestures.toml")
_SECTION = re.compile(r"^(?=\[)", re.MULTILINE)
"""Before each header of a table."""
Table = Mapping[str, Any]


def read_gestures(path: Path = FILE) -> tuple[Gesture, ...]:
    """The gestures of a file, in its order.

    Raises:
        FormatError: A row is wrong.
    """
    rows = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(_read(row, rows, path) for row in rows["gesture"])


def _read(row: Table, rows: Table, path: Path) -> Gesture:
    """The gesture of a row, with what all rows of its file share."""
    shared = {kind: rows.get(kind, {}) for kind in ("hands", "feet", "poses")}
    try:
        return gesture_row(row, {kind: shared[kind] | row.get(kind, {}) for kind in shared}, rows["frames"])
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(path, f"gesture {row.get('name')!r} is wrong at {error}") from error


def gesture_row(row: Table, named: dict[str, Table], frames: Table) -> Gesture:
    poses = {name: pose_row(pose, named) for name, pose in named["poses"].items()}
    cycle = tuple(row["cycle"]) if "cycle" in row else None
    keys: Sequence[Key]
    repeat: Repeat | None = None
    if "again" in row:
        how = dict(row["again"])
        rest = poses[how.pop("rest", "rest")]
        keys, repeat = again([poses[name] for name in how.pop("poses")], **how, rest=rest)
        cycle = repeat.start, repeat.start + repeat.period * max(repeat.times - 1, 1)
    elif "frames" in row:
        how = dict(row["frames"])
        keys, repeat = _laid(_frames(frames[how.pop("of")], named), **how)
    else:
        keys = [(moment, poses[name]) for moment, name in row["keys"]]
    if row.get("through"):
        keys = through(keys)
    steps, handed = row.get("steps", False), row.get("handed", False)
    return Gesture(row["name"], tuple(row["texts"]), tuple(keys), cycle, steps, repeat, handed, row.get("at", ""))


def pose_row(row: Table, named: dict[str, Table]) -> Pose:
    row = dict(row)
    if "hands" in row:
        row["right"] = row["left"] = row.pop("hands")
    if "feet" in row:
        row["right_foot"] = row["left_foot"] = row.pop("feet")
    made: dict[str, Any] = {}
    for name, value in row.items():
        if name in ("right", "left"):
            made[name] = hand_row(named["hands"][value] if isinstance(value, str) else value)
        elif name in ("right_foot", "left_foot"):
            made[name] = _foot(named["feet"][value] if isinstance(value, str) else value)
        else:
            made[name] = _value(value)
    return Pose(**made)


def hand_row(row: Table) -> Hand:
    return Hand(**{name: _value(value) for name, value in row.items()})


def _foot(row: Table) -> Foot:
    if "ground" in row:
        return foot_on(*row["ground"], **{name: value for name, value in row.items() if name != "ground"})
    return Foot(**{name: _value(value) for name, value in row.items()})


def _laid(
    poses: Sequence[Pose],
    loop: tuple[int, int],
    times: int,
    drift: Sequence[float] = (0, 0, 0),
    start: float | None = None,
    end: float = 0.0,
) -> tuple[list[Key], Repeat]:
    """Keys of frames whose loop is played so often, and which are one time of it; `start` and `end` seconds from rest
    to them and back.
    """
    x, y, z = drift
    repeat = Repeat((start or 0.0) + STEP * loop[0], STEP * (loop[1] - loop[0]), times, (x, y, z))
    rows = [(index, 0) for index in range(loop[0])]
    rows += [(index, lap) for lap in range(times) for index in range(*loop)]
    rows += [(index, times - 1) for index in range(loop[1], len(poses))]
    there = [moved(poses[index], [lap * step for step in drift]) for index, lap in rows]
    keys = [(round((start or 0.0) + STEP * number, 3), pose) for number, pose in enumerate(there)]
    return keys if start is None else [(0.0, Pose()), *keys, (keys[-1][0] + end, Pose())], repeat


def _frames(table: Table, named: dict[str, Table]) -> list[Pose]:
    """The poses of a table, of which `pose` is what stays the same."""
    tracks: dict[str, Any] = {name: value for name, value in table.items() if name != "pose"}
    count = len(next(one if isinstance(one, list) else next(iter(one.values())) for one in tracks.values()))
    still, found = pose_row(table["pose"], named), []
    for index in range(count):
        parts = {}
        for name, value in tracks.items():
            if isinstance(value, Mapping):
                part = {inner: _value(one[index]) for inner, one in value.items()}
                parts[name] = replace(getattr(still, name), **part)
            else:
                parts[name] = _value(value[index])
        found.append(replace(still, **parts))
    return found


def _value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


@functools.cache
def read_parts() -> dict[str, tuple[str, Pose]]:
    """By name, the words for each part of the body at which a hand can do something, and how it is there."""
    own = next(one for one in _sections() if one.startswith("[parts]"))
    rows = tomllib.loads(own)["parts"]
    named: dict[str, Table] = {"hands": {}, "feet": {}}
    return {
        name: (row["said"], pose_row({kind: value for kind, value in row.items() if kind != "said"}, named))
        for name, row in rows.items()
    }


@functools.cache
def gestures() -> tuple[Gesture, ...]:
    """The gestures of the package, in the order of its file."""
    return read_gestures()


@functools.cache
def _sections() -> tuple[str, ...]:
    """The sections of the file, each a table of its own that nothing else of the file is needed to parse."""
    return tuple(_SECTION.split(FILE.read_text(encoding="utf-8"))[1:])


@functools.cache
def gesture_of(texts: tuple[str, ...]) -> Gesture | None:
    """The gesture that these sentences tell; None for none. Only its own part of the file is parsed, since all of it
    takes longer than all else that is done for a gesture.
    """
    if not texts:
        return None
    shared = "".join(one for one in _sections() if not one.startswith(("[[gesture]]", "[frames.", "[parts]")))
    for section in _sections():
        if not section.startswith("[[gesture]]") or json.dumps(texts[0], ensure_ascii=False) not in section:
            continue
        (row,) = tomllib.loads(section)["gesture"]
        if tuple(row["texts"]) == texts:
            of = row.get("frames", {}).get("of")
            frames = "".join(one for one in _sections() if of is not None and one.startswith(f"[frames.{of}]"))
            return _read(row, {"frames": {}, **tomllib.loads(shared + frames)}, FILE)
    return None


STANDING = Gesture("standing", (), ((0.0, Pose()), (9.5, Pose())))
"""What gestures that are done once begin and end in."""
