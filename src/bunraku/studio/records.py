"""What a record must hold: the same for what the studio kept of an earlier run and for what a project file says."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from bunraku.core.request.json_form import from_json, read_json
from bunraku.errors import OptionError
from bunraku.studio.workspace.opened import Settings

__all__ = ["CHARACTER_FACTS", "LARGEST", "RECORD", "TAKE_FACTS", "Record", "check_facts", "read_record", "written"]

Record = dict[str, Any]
RECORD = "record.json"
LARGEST = 4 << 20
"""Bytes of a record."""
_Point = tuple[float, float, float]


@dataclass(frozen=True)
class _Axes:
    up: str
    front: str
    sure: float = 1.0
    other: tuple[str, str] | None = None


@dataclass(frozen=True)
class _Unit:
    unit: str
    likely: str | None = None
    note: str = ""


@dataclass(frozen=True)
class _End:
    part: str
    handle: int
    point: _Point


@dataclass(frozen=True)
class _Chain:
    name: str
    kind: str
    joint: int
    points: tuple[_Point, ...]


@dataclass(frozen=True)
class _CharacterFacts:
    """What is known of a character (`opened.told`)."""

    name: str
    file: str
    settings: Settings
    axes: _Axes | None = None
    unit: _Unit | None = None
    vertices: int = 0
    faces: int = 0
    height: float = 0.0
    bounds: tuple[_Point, _Point] | None = None
    joints: int = 0
    rig: bool = False
    physics: bool = False
    apparel: bool = False
    skeleton: bool = False
    picture: int = 0
    mmd: bool = False
    roles: tuple[int, ...] = ()
    positions: tuple[_Point, ...] = ()
    used: tuple[int, ...] = ()
    ends: tuple[_End, ...] = ()
    clips: tuple[str, ...] = ()
    chains: tuple[_Chain, ...] = ()
    unchained: str = ""
    laid: int = 0
    painted: bool = False


@dataclass(frozen=True)
class _Said:
    """A sentence of a take, a clip of the library, or the name of the file that it came from."""

    text: str
    seconds: float = 0.0
    clip: str = ""


@dataclass(frozen=True)
class _TakeFacts:
    """What is known of a take; what was asked for it is read by `studio.forms`."""

    script: tuple[_Said, ...]
    asked: object = None
    how: Literal["animate", "edit", "bend", "dress", "mirror", "trim", "transfer"] = "animate"
    seed: int = 0
    seeds: tuple[int, ...] = ()
    star: bool = False
    title: str = ""
    skin: Literal["handles", "bones"] = "handles"
    fps: float = 20.0
    frames: int = 0
    seconds: float = 0.0
    clip: Literal["clip.bin", "draft.bin"] = "clip.bin"
    stiffness: float | None = None
    gravity: float | None = None
    worn: Literal["learn", "chains"] | None = None

    def __post_init__(self) -> None:
        if not self.script:
            raise OptionError("a take needs a sentence")
        if not isinstance(self.asked, dict | None):
            raise OptionError("what was asked for a take must be an object")
        if self.fps <= 0 or self.seconds < 0 or self.frames < 0:
            raise OptionError("a take cannot last less than no time")


CHARACTER_FACTS = tuple(field.name for field in fields(_CharacterFacts))
TAKE_FACTS = tuple(field.name for field in fields(_TakeFacts))
_FACTS: dict[str, type[_CharacterFacts | _TakeFacts]] = {"characters": _CharacterFacts, "takes": _TakeFacts}
_TEXTS = {
    "characters": ("state", "name", "file"), "takes": ("state", "character"), "jobs": ("kind", "title"),
    "projects": (), "exports": ("file", "title"),
}  # fmt: skip
_OBJECTS = {"jobs": ("params", "about"), "projects": ("view",), "characters": ("settings",)}


def check_facts(kind: str, facts: Mapping[str, Any]) -> None:
    """Whether these are facts of a character or a take, one key each.

    Raises:
        OptionError: One is missing, unknown, or of another type.
    """
    from_json(_FACTS[kind], dict(facts), f"a {kind[:-1]}")


def read_record(kind: str, path: Path) -> tuple[Record | None, str]:
    """The record of a file, and what is wrong with it: no record where it cannot be used.

    A character of which the facts alone are wrong is one that is to be opened again: its state is "unclear".

    Raises:
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(LARGEST + 1)
    try:
        record = read_json(data, "the record", LARGEST)
    except OptionError as error:
        return None, str(error)
    if not isinstance(record, dict):
        return None, "the record is no object"
    wrong = [name for name in _TEXTS[kind] if not isinstance(record.get(name), str)]
    wrong += [name for name in _OBJECTS.get(kind, ()) if not isinstance(record.get(name), dict)]
    created = record.get("created", 0)
    if wrong or isinstance(created, bool) or not isinstance(created, int | float):
        return None, f"the record has no usable '{(wrong or ['created'])[0]}'"
    if kind not in _FACTS:
        return record, ""
    known = TAKE_FACTS if kind == "takes" else CHARACTER_FACTS
    try:
        check_facts(kind, {name: record[name] for name in known if name in record})
    except OptionError as error:
        needed = ("name", "file", "settings", "created")
        try:
            check_facts(kind, {name: record[name] for name in needed[:3]} if kind == "characters" else {})
        except OptionError:
            return None, str(error)
        kept = {name: record[name] for name in needed if name in record}
        return {**kept, "state": "unclear", "error": "", "version": 0}, str(error)
    return record, ""


def written(record: Record) -> bytes:
    """The bytes of a record."""
    kept = {name: value for name, value in record.items() if name != "deleted"}
    return json.dumps(kept, ensure_ascii=False, allow_nan=False).encode()
