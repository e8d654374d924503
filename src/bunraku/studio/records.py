"""What records and saved views must hold, whether an earlier run or a project file brings them."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from bunraku.core.request import GRAVITY, GUIDANCE, SECONDS, STEPS, STIFFNESS, Limit, from_json, read_json
from bunraku.core.travel import LONGEST
from bunraku.errors import OptionError
from bunraku.studio.forms import MOST_PARTS, MOST_SEED, TIME, Motion, PoseForm, read_pins
from bunraku.studio.workspace import Settings

__all__ = [
    "CHARACTER_FACTS", "LARGEST", "RECORD", "Record", "TAKE_FACTS", "View", "check_facts", "checked_view",
    "read_record", "read_view", "written",
]  # fmt: skip


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
    """What is known of a character (`tasks.Open`)."""

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
    """A sentence, a clip of the library, or the name of a file that a take came from."""

    text: str
    seconds: float = 0.0
    clip: str = ""


@dataclass(frozen=True)
class _TakeFacts:
    """What is known of a take; `asked` is read by `studio.forms`."""

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
            raise OptionError("the length of a take cannot be negative")


CHARACTER_FACTS = tuple(field.name for field in fields(_CharacterFacts))
TAKE_FACTS = tuple(field.name for field in fields(_TakeFacts))
_FACTS: dict[str, type[_CharacterFacts | _TakeFacts]] = {"characters": _CharacterFacts, "takes": _TakeFacts}
_TEXTS = {
    "characters": ("state", "name", "file"), "takes": ("state", "character"), "jobs": ("kind", "title"),
    "projects": (), "exports": ("file", "title"),
}  # fmt: skip
_OBJECTS = {"jobs": ("params", "about"), "projects": ("view",), "characters": ("settings",)}


def check_facts(kind: str, facts: Mapping[str, Any]) -> None:
    """Whether these are facts of a character or a take, one key each; OptionError where one is missing, unknown, or of
    another type.
    """
    from_json(_FACTS[kind], dict(facts), f"a {kind[:-1]}")


def read_record(kind: str, path: Path) -> tuple[Record | None, str]:
    """The record of a file, None where it cannot be used, and what is wrong with it; OSError where the file cannot be
    read. A character with wrong facts alone gets the state "unclear", and is opened again.
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
    facts = TAKE_FACTS if kind == "takes" else CHARACTER_FACTS
    try:
        check_facts(kind, {name: record[name] for name in facts if name in record})
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


@dataclass(frozen=True)
class _Sentence:
    """A sentence as it is typed, empty or too long for a take perhaps; or a clip of the library."""

    text: str
    seconds: float
    clip: str = ""

    def __post_init__(self) -> None:
        SECONDS.check(self.seconds)


@dataclass(frozen=True, kw_only=True)
class View:
    """The state of a page; the names are the page's, and mean what they mean in `forms`.

    Args:
        character, take: What is chosen.
        script: The sentences of the timeline, of which number `sentence` is in the box.
        seed: Of the first of `count` takes.
        live: Whether springs of hair and clothes swing in the page.
    """

    character: str | None = None
    take: str | None = None
    script: tuple[_Sentence, ...] = (_Sentence("walks", 4.0),)
    sentence: int = 0
    seed: int = 0
    count: Literal[1, 4] = 1
    loop: bool = False
    inPlace: bool = False
    apparel: Motion = "rigid"
    stiffness: float = 1.0
    gravity: float = 1.0
    live: bool = False
    guidance: float | None = None
    steps: int | None = None
    pins: tuple[object, ...] = ()
    poses: tuple[PoseForm, ...] = ()
    path: tuple[tuple[float, float], ...] = ()
    span: tuple[float, float] | None = None
    keep: tuple[str, ...] = ()
    rig: Literal["handles", "own"] = "handles"

    def __post_init__(self) -> None:
        if not 1 <= len(self.script) <= MOST_PARTS:
            raise OptionError(f"script has 1 to {MOST_PARTS} entries")
        Limit("sentence", 0, MOST_PARTS - 1).check(self.sentence)
        Limit("seed", 0, MOST_SEED - 1).check(self.seed)
        STIFFNESS.check(self.stiffness)
        GRAVITY.check(self.gravity)
        GUIDANCE.check(self.guidance)
        STEPS.check(self.steps)
        for coordinate in itertools.chain.from_iterable(self.path):
            Limit("x and z of a path", -LONGEST, LONGEST).check(coordinate)
        for second in self.span or ():
            TIME.check(second, "span")
        read_pins(self.pins)


def checked_view(view: object) -> dict[str, Any]:
    """The view that a page sent; none is an empty one; OptionError where it holds what a page cannot show."""
    form: Any = {} if view is None else view
    from_json(View, form, "the view")
    return dict(form)


def read_view(view: object) -> dict[str, Any]:
    """What can be shown of a view that this version or another kept."""
    names: Sequence[str] = [field.name for field in fields(View)]
    settings = {name: view[name] for name in names if name in view} if isinstance(view, dict) else {}
    for name in list(settings):
        try:
            from_json(View, {name: settings[name]})
        except OptionError:
            del settings[name]
    return settings
