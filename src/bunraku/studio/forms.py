"""What a page requests, a dataclass per form: the same for a request of the page, a link and a project file."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from bunraku.core.request import (
    CANDIDATES,
    FPS,
    GRAVITY,
    GUIDANCE,
    PLACE,
    SECONDS,
    STEPS,
    STIFFNESS,
    Length,
    Limit,
    from_json,
    to_json,
)
from bunraku.core.travel import LONGEST
from bunraku.errors import OptionError
from bunraku.files import UNIT_CHOICES, preset_named
from bunraku.generation.library import clip as find_clip
from bunraku.pipelines.apply import GENERATED_STAGES
from bunraku.pipelines.requests import Apparel, Constraints, Keep, Pose, Request, Sampling
from bunraku.retarget.pins import Pin

MOST_SEEDS = 8
MOST_SEED = 2**53
"""Seeds are less, so that a browser knows them exactly."""
TURNED = Limit("direction", -1e6, 1e6)
TIME = Limit("time", 0, SECONDS.high)
Motion = Literal["rigid", "simulate", "chains", "learn"]
"""How apparel moves."""


Ground = Annotated[float, Limit("x and z of a path", -LONGEST, LONGEST)]


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """How takes are drawn: as `Sampling` and `Request` say it, with a seed for each take, the names of stages that are
    left out.
    """

    seeds: Annotated[tuple[float, ...], Length(MOST_SEEDS)] = (0,)
    steps: Annotated[int | None, STEPS] = None
    guidance: Annotated[float | None, GUIDANCE] = None
    candidates: Annotated[int, CANDIDATES] = 3
    force: bool = False
    without: tuple[str, ...] = ()
    pins: tuple[Pin, ...] = ()

    def __post_init__(self) -> None:
        if any(seed != int(seed) or not 0 <= seed < MOST_SEED for seed in self.seeds):
            raise OptionError("seeds are whole numbers from 0 on")
        object.__setattr__(self, "seeds", tuple(int(seed) for seed in self.seeds) or (0,))

    def sampling(self, seconds: float | None) -> Sampling:
        """The same of a clip of some seconds, None for what fits."""
        return Sampling(seconds, int(self.seeds[0]), self.steps, self.guidance, self.candidates)


@dataclass(frozen=True, kw_only=True)
class DressForm:
    """How the apparel of takes moves; see `Apparel`."""

    apparel: Motion = "rigid"
    stiffness: Annotated[float, STIFFNESS] = 1.0
    gravity: Annotated[float, GRAVITY] = 1.0

    @property
    def apparel_request(self) -> Apparel:
        """The same as a part of a request."""
        return Apparel(self.apparel, self.stiffness, self.gravity)

    @property
    def dress(self) -> dict[str, Any]:
        """The same alone, as a JSON object."""
        return {"apparel": self.apparel, "stiffness": self.stiffness, "gravity": self.gravity}


MOST_PARTS = 20
Words = Annotated[str, Length(1000)]
Title = Annotated[str, Length(80)]


@dataclass(frozen=True)
class Part:
    """A sentence of a script with its length [s], or a clip of the library by its name, which is played as it is. A
    sentence that `fits` is as long as what is done, whatever stands here, and so is one without a length.
    """

    text: Words
    seconds: float = 0.0
    clip: str = ""
    fits: bool = False

    def __post_init__(self) -> None:
        clip = find_clip(self.clip) if self.clip else None
        object.__setattr__(self, "fits", clip is None and (self.fits or not self.seconds))
        object.__setattr__(self, "seconds", self.seconds or (0.0 if clip is None else clip.seconds))
        SECONDS.check(self.seconds or None)


def read_script(script: Sequence[Part]) -> tuple[Part, ...]:
    """The sentences of a script one by one: a row such as "walks:4; jumps:2" is several. OptionError where a sentence
    is empty, or all together are too long.
    """
    from bunraku.language.parse import parse
    from bunraku.language.prompts import parse_sequence, timed_sequence

    if not script or not all(part.clip or part.text.strip(" ;\n\t") for part in script):
        raise OptionError("type what the character does, such as: walks forward, then waves")
    Length(MOST_PARTS).check(script, "script")
    timed: list[Part] = []
    for part in script:
        if part.clip:
            timed.append(part)
            continue
        typed = parse_sequence(part.text.replace("\n", " ").strip())
        for text, seconds in timed_sequence(typed, None if part.fits else part.seconds):
            timed.append(Part(text, seconds or parse(text, force=True).seconds, fits=seconds is None))
    Length(MOST_PARTS).check(timed, "script")
    if sum(part.seconds for part in timed) > SECONDS.high:
        raise OptionError(f"all sentences together last at most {SECONDS.high:g} seconds; shorten some")
    return tuple(timed)


def sequence_of(script: Sequence[Part]) -> str:
    """The sentences in a row, as a prompt says them."""
    return "; ".join(part.text if part.fits else f"{part.text}:{part.seconds:g}" for part in script)


def _asked(script: Sequence[Part]) -> float | None:
    """The length of a script [s]; None where a sentence takes what fits."""
    return None if any(part.fits for part in script) else sum(part.seconds for part in script)


def script_json(script: Sequence[Part]) -> list[dict[str, object]]:
    """What a record keeps of a script."""
    return [
        {name: value for name, value in vars(part).items() if value or name in ("text", "seconds")} for part in script
    ]


@dataclass(frozen=True, kw_only=True)
class TakeForm(Drawn, DressForm):
    """Takes that are made from sentences.

    Args:
        script: What the character does.
        draft: Show a quick one first.
        loop: Make loops.
        in_place: Remove the travel over the ground.
        path: Points that the root passes, x and z [m].
        after: The take in whose last pose these start.
        rig: What moves: handles, or the bones of the file's own skeleton.
    """

    script: tuple[Part, ...] = ()
    draft: bool = True
    loop: bool = False
    in_place: bool = False
    path: tuple[tuple[Ground, Ground], ...] | None = None
    after: str | None = None
    rig: Literal["handles", "own"] = "handles"

    def request(self, handles: Literal["predict", "rig"] = "predict") -> Request:
        """The request, checked; a take that is followed is only named. `handles` says how the character's were made.
        OptionError where it cannot be requested, or a sentence is not understood.
        """
        # pins and paths go by the length that the page shows
        given = [replace(part, fits=False) for part in self.script] if self.pins or self.path else self.script
        script = read_script(given)
        request = Request(
            sequence_of(script), self.sampling(_asked(script)), self.constraints(),
            self.apparel_request, GENERATED_STAGES.without(self.without),
            "predict" if self.apparel == "simulate" else handles, self.force,
            self.rig if self.rig == "own" else "auto" if self.apparel in ("simulate", "learn") else "handles",
        )  # fmt: skip
        request.check()
        return request.with_parsed()

    def pieces(self, handles: Literal["predict", "rig"] = "predict") -> list[dict[str, Any]]:
        """The JSON forms of clips and of requests of the sentences between them, of a script with clips; OptionError
        where it cannot be requested, or a sentence is not understood.
        """
        if self.after:
            raise OptionError("a script with clips follows no other take; put its clip or sentence before them")
        pieces: list[dict[str, Any]] = []
        for played, parts in itertools.groupby(read_script(self.script), lambda part: bool(part.clip)):
            if played:
                pieces += [{"clip": part.clip, "seconds": part.seconds} for part in parts]
                continue
            script = tuple(parts)
            bare = replace(self, script=script, loop=False, in_place=False, path=None, pins=(), apparel="rigid")
            seconds = sum(part.seconds for part in script)
            pieces.append({"seconds": seconds, "request": bare.request(handles).to_json()})
        return pieces

    def constraints(self) -> Constraints:
        """What takes must meet, checked; of scripts with clips only a single clip can be a loop."""
        loop = self.loop and (len(self.script) == 1 or not any(part.clip for part in self.script))
        constraints = Constraints.of(
            loop=loop, in_place=self.in_place, after=self.after or None, path=self.path or None, pins=self.pins
        )
        constraints.check()
        return constraints

    def asked(self) -> dict[str, Any]:
        """What a take's record keeps of it, for links."""
        kept = "seeds steps guidance loop in_place apparel stiffness gravity path pins rig"
        return {name: to_json(getattr(self, name)) for name in kept.split()}


@dataclass(frozen=True, kw_only=True)
class CharacterForm:
    """What a page changes of a character.

    Args:
        name: Its name.
        deleted: Whether it is given up.
        up, front, unit, handles: How its file is read; see `workspace.Settings`.
    """

    name: Title | None = None
    deleted: bool | None = None
    up: Literal["auto", "+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    front: Literal["auto", "+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    unit: str | None = None
    handles: Literal["predict", "rig"] | None = None

    def __post_init__(self) -> None:
        if self.unit is not None and self.unit not in UNIT_CHOICES:
            raise OptionError(f"unit is one of {', '.join(UNIT_CHOICES)}")


@dataclass(frozen=True, kw_only=True)
class ExportForm:
    """The file that a take is written as.

    Args:
        format: Its suffix.
        fps: Frames a second [1/s].
    """

    format: Literal["glb", "bvh", "vrma", "vmd", "npz", "fbx", "usdz", "usdc", "mp4", "gif"] = "glb"
    fps: Annotated[float, FPS] = 30.0


@dataclass(frozen=True, kw_only=True)
class TakeRecordForm:
    """What a page changes of a take.

    Args:
        star: Whether it is starred.
        deleted: Whether it is given up.
        title: Its name; "" is that of its sentence.
    """

    star: bool | None = None
    deleted: bool | None = None
    title: Title | None = None


@dataclass(frozen=True, kw_only=True)
class ChangeForm(Drawn):
    """Takes that are made from one: parts kept and the rest generated, bent to pins, dressed anew, mirrored, trimmed.

    Args:
        prompt: What is done instead; nothing is generated where it is empty.
        keep: Parts that stay.
        span: The first and the last second that are generated.
        poses: Poses that stay.
        apparel, stiffness, gravity: How apparel moves, where that is to change.
        mirror: Left and right are exchanged; nothing else is then changed.
        trim: The first and the last second of what stays.
    """

    prompt: Words = ""
    keep: tuple[str, ...] = ()
    span: tuple[Annotated[float, TIME], ...] | None = None
    poses: tuple[Pose, ...] = ()
    apparel: Motion | None = None
    stiffness: Annotated[float, STIFFNESS] = 1.0
    gravity: Annotated[float, GRAVITY] = 1.0
    mirror: bool = False
    trim: tuple[Annotated[float, TIME], Annotated[float, TIME]] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.span or ()) not in (0, 2):
            raise OptionError("a span is two seconds, from and to")
        if self.trim and self.trim[0] >= self.trim[1]:
            raise OptionError("trim is from an earlier second to a later one")

    def request(self, apparel: Apparel) -> Request:
        """The request of an edit, checked, with how the apparel of the take moves; OptionError where nothing is kept,
        or the sentence is not understood.
        """
        from bunraku.core.body.layout import kept_handles

        if self.keep:
            kept_handles(self.keep)
        if not self.keep and not self.span and not self.poses:
            raise OptionError("nothing is kept: select a span of time, keep parts of the body, or pin poses")
        span = (self.span[0], self.span[1]) if self.span else None
        stays = [Keep(self.keep, span)] if self.keep or span else []
        request = Request(
            self.prompt.strip(), self.sampling(6.0), Constraints((*stays, *self.poses, *self.pins)), apparel,
            GENERATED_STAGES.without(self.without), force=self.force,
        )  # fmt: skip
        request.check(clip=True)
        return request.with_parsed()

    def asked(self, apparel: Apparel) -> dict[str, Any]:
        """What a take's record keeps of it."""
        kept = ("seeds", "keep", "span", "poses", "pins", "prompt")
        return {**{name: to_json(getattr(self, name)) for name in kept}, "apparel": apparel.motion,
                "stiffness": apparel.stiffness, "gravity": apparel.gravity}  # fmt: skip


_Place = tuple[Annotated[float, PLACE], Annotated[float, PLACE], Annotated[float, PLACE]]


@dataclass(frozen=True, kw_only=True)
class LiveForm:
    """The next poses of a character that never stops (`bunraku.live`).

    Args:
        session: The name that the first answer gave; "" begins another.
        sentence: What it does next; "" goes on.
        direction: Where it faces and travels, x and z; None lets sentences decide.
        look: A point in the world that it looks at [m]; None looks ahead.
        reach: A point that its nearest hand goes to; None for none.
        start: The number of the first pose, where those that came before from there on were not shown.
        seconds: How much comes.
    """

    session: str = ""
    sentence: Words = ""
    direction: tuple[Annotated[float, TURNED], Annotated[float, TURNED]] | None = None
    look: _Place | None = None
    reach: _Place | None = None
    start: Annotated[int | None, Limit("start", 0, 2**53)] = None
    seconds: Annotated[float, Limit("seconds", 0.1, 4)] = 1.0


@dataclass(frozen=True, kw_only=True)
class PlayedForm:
    """A take of what a character that never stops was seen to do, of at most the last minute.

    Args:
        session: As of `LiveForm`.
        stop: The number of the first pose that was not shown; None where all that were given were.
        text: What it is called.
    """

    session: str
    stop: Annotated[int | None, Limit("stop", 1, 2**53)] = None
    text: Annotated[str, Length(1000, 1)] = "live"


MOST_CLIPS, MOST_BESIDE = 100, 9
"""Takes in one file, and in one video."""


@dataclass(frozen=True, kw_only=True)
class ClipsForm:
    """Takes that become the clips of one file, or stand side by side in a video.

    Args:
        takes: Their names, in order, each once.
        format: What is written where no preset says it.
        fps: Frames a second [1/s]; 0 for the preset's.
        preset: The program that the file is for, one of `files.presets`; "" for a plain GLB.
    """

    takes: tuple[str, ...] = ()
    fps: float = 30.0
    preset: str = ""
    format: Literal["glb", "mp4", "gif"] = "glb"

    def __post_init__(self) -> None:
        if self.preset:
            preset_named(self.preset)
        if not self.preset or self.fps:
            FPS.check(self.fps)
        if not 1 <= len(self.takes) <= MOST_CLIPS or len(set(self.takes)) < len(self.takes):
            raise OptionError(f"one file has 1 to {MOST_CLIPS} clips, each another take; choose them again")
        if self.format != "glb" and len(self.takes) > MOST_BESIDE:
            raise OptionError(f"at most {MOST_BESIDE} takes stand side by side in a video; choose fewer")


def check_asked(how: object, script: object, asked: object) -> None:
    """Raise OptionError unless a page can have requested a take: how it was made, its script and its record's form."""
    kept: dict[str, Any] = asked if isinstance(asked, dict) else {}
    if how == "animate":
        form = from_json(TakeForm, {**kept, "script": script})
        read_script(form.script)
        form.constraints()
    elif how == "edit":
        from_json(ChangeForm, kept)
    else:
        from_json(DressForm, {name: kept[name] for name in ("apparel", "stiffness", "gravity") if name in kept})
