"""Gestures (`gestures.toml`), things for the hands (`things.toml`), and gestures moved to another part of the body."""

from __future__ import annotations

import functools
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bunraku.core.geometry.rotations import matrix_y
from bunraku.errors import FormatError
from bunraku.gestures.play import SIDES
from bunraku.gestures.pose import (
    HANGING,
    STEP,
    Foot,
    Gesture,
    Hand,
    Key,
    Pose,
    Repeat,
    added,
    again,
    foot_on,
    moved,
    through,
    vector,
)
from bunraku.language.lexicon import Phrases, longest_pattern, words_of

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
    """The gesture of a row, with the hands, feet, poses and frames that it names."""
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


def pose_row(row: Table, named: Mapping[str, Table] | None = None) -> Pose:
    """The pose of a row, with the hands and feet that it names."""
    named = named or {"hands": {}, "feet": {}}
    pose: dict[str, Any] = {}
    for name, value in row.items():
        if name in ("hands", "right", "left"):
            hand = hand_row(named["hands"][value] if isinstance(value, str) else value)
            pose |= {"right": hand, "left": hand} if name == "hands" else {name: hand}
        elif name in ("feet", "right_foot", "left_foot"):
            foot = _foot(named["feet"][value] if isinstance(value, str) else value)
            pose |= {"right_foot": foot, "left_foot": foot} if name == "feet" else {name: foot}
        else:
            pose[name] = _value(value)
    return Pose(**pose)


def hand_row(row: Table) -> Hand:
    """The hand of a row."""
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
    """Keys of frames whose loop is played `times` times, and which are one of them; `start` and `end` seconds from rest
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
    count = len(next(row if isinstance(row, list) else next(iter(row.values())) for row in tracks.values()))
    still, rows = pose_row(table["pose"], named), []
    for index in range(count):
        parts = {}
        for name, value in tracks.items():
            if isinstance(value, Mapping):
                part = {inner: _value(row[index]) for inner, row in value.items()}
                parts[name] = replace(getattr(still, name), **part)
            else:
                parts[name] = _value(value[index])
        rows.append(replace(still, **parts))
    return rows


def _value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


@functools.cache
def read_parts() -> dict[str, tuple[str, Pose]]:
    """By name, the words for each part of the body at which a hand can do something, and how it is there."""
    rows = tomllib.loads(next(section for section in _sections() if section.startswith("[parts]")))["parts"]
    return {name: (row.pop("said"), pose_row(row)) for name, row in rows.items()}


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
    """The gesture with these texts; None for none. Only its own part of the file is parsed: all of it takes longer than
    all else that is done for a gesture.
    """
    if not texts:
        return None
    shared = [section for section in _sections() if not section.startswith(("[[gesture]]", "[frames.", "[parts]"))]
    for section in _sections():
        if not section.startswith("[[gesture]]") or json.dumps(texts[0], ensure_ascii=False) not in section:
            continue
        (row,) = tomllib.loads(section)["gesture"]
        if tuple(row["texts"]) == texts:
            head = f"[frames.{row['frames']['of']}]" if "frames" in row else "[frames.]"
            frames = [section for section in _sections() if section.startswith(head)]
            return _read(row, {"frames": {}, **tomllib.loads("".join(shared + frames))}, FILE)
    return None


# Chosen by eye.
STANDING = Gesture("standing", (), ((0.0, Pose()), (9.5, Pose())))
"""What gestures that are done once begin and end in."""


AWAY, HIPS, CHEST, HEAD, OVER = 68.0, 18.0, 26.0, 14.0, 0.06
"""How far from straight ahead a place aside is, how far pelvis, chest and head turn towards it [degrees], and how far
the pelvis goes to that side [m]; chosen by eye.
"""


class PlaceRow(NamedTuple):
    """The body at a place for things: both hands there, one hand there, the other one then, and the rest."""

    both: Hand
    one: Hand
    other: Hand
    pose: Pose


@functools.cache
def things_file() -> dict[str, Any]:
    """The tables of `things.toml`."""
    return tomllib.loads(Path(__file__).with_name("things.toml").read_text(encoding="utf-8"))


@functools.cache
def read_places() -> dict[str, PlaceRow]:
    """The places of `[places]` by their names, the lowest first."""
    return {name: _place(row) for name, row in things_file()["places"].items()}


def _place(row: dict[str, Any]) -> PlaceRow:
    pose = pose_row({kind: value for kind, value in row.items() if kind not in ("both", "one", "other")})
    other = hand_row(row["other"]) if "other" in row else HANGING
    return PlaceRow(hand_row(row["both"]), hand_row(row["one"]), other, pose)


def _at_height(height: float) -> PlaceRow:
    """The place whose palm is so high [m], between the two nearest."""
    rows = list(read_places().values())
    heights = [row.one.palm[1] for row in rows]
    after = int(np.clip(np.searchsorted(heights, height), 1, len(rows) - 1))
    share = float(np.clip((height - heights[after - 1]) / (heights[after] - heights[after - 1]), 0, 1))
    first, last = rows[after - 1], rows[after]
    both, single, pose = (_mixed(getattr(first, part), getattr(last, part), share) for part in ("both", "one", "pose"))
    return PlaceRow(both, single, (last if share > 0.5 else first).other, pose)


def _mixed(one: Any, other: Any, share: float) -> Any:
    """A hand or a pose between two: numbers and vectors go over, what else there is stays the first's."""
    parts = {}
    for part in fields(one):
        value, there = getattr(one, part.name), getattr(other, part.name)
        if isinstance(value, tuple):
            parts[part.name] = tuple((1 - share) * a + share * b for a, b in zip(value, there, strict=True))
        elif isinstance(value, float | int):
            parts[part.name] = (1 - share) * value + share * there
    return replace(one, **parts)


def place_pose(height: str | float, way: str, hands: str, held: bool = False) -> Pose:
    """The body with both hands, or one of them, at a place.

    Args:
        height: Of the palms, by its name or in metres.
        way: "left" or "right"; "" for straight ahead.
        hands: "both", "left", "right", or "one" for the right one.
        held: Whether hands go along with the chest where they are straight ahead.
    """
    row = read_places()[height] if isinstance(height, str) else _at_height(height)
    side = float(way == "left") - float(way == "right")
    base, hand_row = row.pose, row.both if hands == "both" else row.one
    turned = matrix_y(np.array(np.radians(side * AWAY)))
    carrier: Literal["chest", "ground"] = "chest" if held and not side else "ground"

    def placed(hand: Hand, sign: float) -> Hand:
        out = np.array([sign, 1, 1])
        palm, fingers, faces, elbow = (
            vector(out * (turned @ (out * np.array(direction))))
            for direction in (hand.palm, hand.fingers, hand.faces, hand.elbow)
        )
        return Hand(palm, fingers, faces, elbow, on=carrier)

    used = {name: hands in ("both", name) or (hands == "one" and name == "right") for name, _ in SIDES}
    both: dict[str, Any] = {name: placed(hand_row, sign) if used[name] else row.other for name, sign in SIDES}
    hips = matrix_y(np.array(np.radians(side * HIPS))) @ np.array(base.hips) + [side * OVER, 0, 0]
    lean, head = base.lean, base.head
    return replace(
        base, **both, hips=vector(hips), turn=side * HIPS,
        lean=(lean[0], lean[1] + side * CHEST, lean[2]), head=(head[0], head[1] + side * HEAD, head[2]),
    )  # fmt: skip


class Part(NamedTuple):
    """A part of the body that a sentence names."""

    name: str  # of `[parts]` in `gestures.toml`
    words: tuple[str, ...]  # those of the sentence that say it


def part_in(text: str) -> Part | None:
    """The part of the body that a text names with the most words; None for none that a hand reaches."""
    words = words_of(text)[0]
    found = [(at, longest_pattern(_phrases().starting(word), words, at)) for at, word in enumerate(words)]
    parts = [Part(phrase[0].name, tuple(words[at : phrase[1]])) for at, phrase in found if phrase]
    return max(parts, key=lambda one: len(one.words), default=None)


@functools.cache
def _phrases() -> Phrases:
    """The phrases of all parts."""
    return Phrases([("parts", name, said.split(", ")) for name, (said, _) in read_parts().items()], {})


@functools.lru_cache(maxsize=64)
def at_part(gesture: Gesture, name: str) -> Gesture:
    """A gesture of the right hand done at another part of the body: its movement along the surface there, and the body
    bent as far as the hand has to reach.

    Args:
        gesture: With an `at` of its own.
        name: Of the part.
    """
    from_part, there = (read_parts()[part_name][1] for part_name in (gesture.at, name))
    turn = _frame(there.right) @ _frame(from_part.right).T

    def moved(pose: Pose) -> Pose:
        if replace(pose.right, on=HANGING.on) == HANGING:
            return pose
        away = turn @ (np.array(pose.right.palm) - from_part.right.palm)
        palm = tuple((np.array(there.right.palm) + away).tolist())
        lean, head, hips = (added(getattr(pose, part), getattr(there, part)) for part in ("lean", "head", "hips"))
        return replace(pose, right=replace(there.right, palm=palm), lean=lean, head=head, hips=hips)

    return replace(gesture, keys=tuple((time, moved(pose)) for time, pose in gesture.keys), at=name)


def _frame(hand: Hand) -> np.ndarray:
    """Axes of a hand: along the fingers, out of the palm, across both."""
    along = np.array(hand.fingers) / np.linalg.norm(hand.fingers)
    out = np.array(hand.faces) - along * (along @ np.array(hand.faces))
    out /= np.linalg.norm(out)
    return np.stack([along, out, np.cross(along, out)], axis=1)
