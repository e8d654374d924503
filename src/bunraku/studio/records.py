"""What records and saved views must hold, whether an earlier run or a project file brings them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from bunraku.core.body.corrections import Corrections
from bunraku.core.request import FPS, GRAVITY, GUIDANCE, SECONDS, STEPS, STIFFNESS, WHOLE, Limit, from_json, read_json
from bunraku.errors import OptionError
from bunraku.pipelines.requests import Pose
from bunraku.retarget.pins import Pin
from bunraku.studio.forms import MOST_PARTS, MOST_SEED, TIME, Ground, Motion
from bunraku.studio.workspace import MAX_VERTICES, Settings

Record = dict[str, Any]
RECORD = "record.json"
LARGEST = 4 << 20
"""Bytes of a record."""
_COUNT = Limit("count", 0, 2**53)
"""Numbers of versions, which a browser knows exactly."""
_FAR = Limit("coordinates", -1e6, 1e6)
"""Metres; farther from the origin a float32 is coarser than 6 cm."""
_Count = Annotated[int, _COUNT]
_Index = Annotated[int, Limit("number", 0, MAX_VERTICES)]
_Seed = Annotated[int, Limit("seed", 0, MOST_SEED - 1)]
_Share = Annotated[float, Limit("share", 0, 1)]
_Metres = Annotated[float, _FAR]
_Point = tuple[_Metres, _Metres, _Metres]


@dataclass(frozen=True)
class _Axes:
    up: str
    front: str
    sure: _Share = 1.0
    other: tuple[str, str] | None = None


@dataclass(frozen=True)
class _Unit:
    unit: str
    likely: str | None = None
    note: str = ""


@dataclass(frozen=True)
class _End:
    part: str
    handle: _Index
    point: _Point


@dataclass(frozen=True)
class _Chain:
    name: str
    kind: str
    joint: _Index
    points: tuple[_Point, ...]


@dataclass(frozen=True)
class _Joint:
    name: str
    parent: str | None
    point: _Point


@dataclass(frozen=True)
class _Piece:
    kind: str
    at: _Point
    area: _Share


@dataclass(frozen=True)
class _Dress(_Piece):
    carrier: str


@dataclass(frozen=True)
class _Body:
    joints: tuple[_Joint, ...]
    parts: tuple[_Piece, ...]
    said: Corrections


@dataclass(frozen=True)
class _CharacterFacts:
    """What is known of a character (`tasks.Open`)."""

    name: str
    file: str
    settings: Settings
    axes: _Axes | None = None
    unit: _Unit | None = None
    vertices: _Index = 0
    faces: _Count = 0
    height: _Metres = 0.0
    bounds: tuple[_Point, _Point] | None = None
    joints: _Index = 0
    rig: bool = False
    physics: bool = False
    apparel: bool = False
    skeleton: bool = False
    picture: _Count = 0
    mmd: bool = False
    body: _Body | None = None
    roles: tuple[_Index, ...] = ()
    positions: tuple[_Point, ...] = ()
    used: tuple[_Index, ...] = ()
    ends: tuple[_End, ...] = ()
    dress: tuple[_Dress, ...] = ()
    clips: tuple[str, ...] = ()
    chains: tuple[_Chain, ...] = ()
    unchained: str = ""
    sample: str = ""
    laid: _Count = 0
    painted: bool = False


_Length = Annotated[float, Limit("seconds", 0, WHOLE.high)]


@dataclass(frozen=True)
class _Said:
    """A sentence, a clip of the library, or the name of a file that a take came from."""

    text: str
    seconds: _Length = 0.0
    clip: str = ""
    fits: bool = False


@dataclass(frozen=True)
class _TakeFacts:
    """What is known of a take; `asked` is read by `studio.forms`."""

    script: tuple[_Said, ...]
    asked: object = None
    how: Literal["animate", "edit", "bend", "dress", "mirror", "trim", "transfer", "live"] = "animate"
    seed: _Seed = 0
    seeds: tuple[_Seed, ...] = ()
    star: bool = False
    title: str = ""
    skin: Literal["handles", "bones"] = "handles"
    fps: Annotated[float, FPS] = 20.0
    frames: Annotated[int, Limit("frames", 0, WHOLE.high * FPS.high)] = 0
    seconds: _Length = 0.0
    clip: Literal["clip.bin", "draft.bin"] = "clip.bin"
    stiffness: Annotated[float | None, STIFFNESS] = None
    gravity: Annotated[float | None, GRAVITY] = None
    worn: Literal["learn", "chains"] | None = None

    def __post_init__(self) -> None:
        if not self.script:
            raise OptionError("a take needs a sentence")
        if not isinstance(self.asked, dict | None):
            raise OptionError("what was asked for a take must be an object")
        if self.frames and abs(self.seconds - self.frames / self.fps) > 1:
            raise OptionError("a take lasts as long as its frames")


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


_Time = Annotated[float, TIME]


@dataclass(frozen=True)
class _Sentence:
    """A sentence as it is typed, empty or too long for a take perhaps; or a clip of the library."""

    text: str
    seconds: Annotated[float, SECONDS]
    clip: str = ""
    fits: bool = False


@dataclass(frozen=True, kw_only=True)
class View:
    """The state of a page; the names are the page's, and mean what they mean in `forms`."""

    character: str | None = None  # what is chosen, and `take`
    take: str | None = None
    # The sentences of the timeline, of which number `sentence` is in the box.
    script: tuple[_Sentence, ...] = (_Sentence("walks", 4.0),)
    sentence: Annotated[int, Limit("sentence", 0, MOST_PARTS - 1)] = 0
    seed: _Seed = 0  # of the first of `count` takes
    count: Literal[1, 4] = 1
    loop: bool = False
    inPlace: bool = False
    apparel: Motion = "rigid"
    stiffness: Annotated[float, STIFFNESS] = 1.0
    gravity: Annotated[float, GRAVITY] = 1.0
    live: bool = False  # whether springs of hair and clothes swing in the page
    guidance: Annotated[float | None, GUIDANCE] = None
    steps: Annotated[int | None, STEPS] = None
    pins: tuple[Pin, ...] = ()
    poses: tuple[Pose, ...] = ()
    path: tuple[tuple[Ground, Ground], ...] = ()
    span: tuple[_Time, _Time] | None = None
    keep: tuple[str, ...] = ()
    rig: Literal["handles", "own"] = "handles"

    def __post_init__(self) -> None:
        if not 1 <= len(self.script) <= MOST_PARTS:
            raise OptionError(f"script has 1 to {MOST_PARTS} entries")


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
