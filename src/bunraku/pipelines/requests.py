"""What is requested: a sentence or a motion, sampling, constraints, how apparel moves, and which clips are loops."""

from __future__ import annotations

import importlib
import math
import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

from bunraku.core.request import (
    CANDIDATES,
    FPS,
    GRAVITY,
    GUIDANCE,
    MOMENT,
    SEED,
    STEPS,
    STIFFNESS,
    USUAL,
    WHOLE,
    Constraint,
    check_all,
    from_json,
    to_json,
)
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter
    from bunraku.core.character import Handles
    from bunraku.core.motion import HandleMotion
    from bunraku.core.travel import GroundPath
    from bunraku.language.sentence import Sentence
    from bunraku.retarget.fit import Stages
    from bunraku.retarget.pins import Pin

APPAREL = ("auto", "none", "rigid", "simulate", "chains", "learn")
"""How apparel may move, beside a mask; "rigid" is another word for "none"."""
MASKS = (".npy", ".txt", ".ply", ".glb")


@dataclass(frozen=True)
class Apparel:
    """How hair and clothes move.

    Args:
        motion: "none" (or "rigid") moves them with the body; "simulate" by the rigid bodies or springs of an MMD or VRM
            file, or else by the bones of hair and clothes of a person's rig; "chains" by simulated chains of bones over
            what a network finds on any mesh; "learn" by a network; "auto" by the first of physics, bones and chains
            that there is; or the file of a mask of what is to be learned.
        stiffness: Factor on the stiffness of apparel, 0.001 to 1000.
        gravity: Factor on the gravity of simulated apparel, 0 to 10.
    """

    motion: str = "none"
    stiffness: float = 1.0
    gravity: float = 1.0

    @property
    def moves(self) -> bool:
        """Whether apparel moves on its own by this, or may."""
        return self.motion not in ("none", "rigid")

    @property
    def learns(self) -> bool:
        """Whether a network moves apparel by this, whatever the file has."""
        return self.motion == "learn" or self.mask is not None

    @property
    def mask(self) -> Path | None:
        """The file of a mask, where one names what is apparel."""
        return None if self.motion in APPAREL else Path(self.motion)

    def check(self, dashes: str = "") -> None:
        """Whether apparel can move so; `dashes` stand before the names of options in messages.

        Raises:
            OptionError: It cannot.
            MissingExtraError: The physics engine is not installed.
        """
        from bunraku.apparel.physics.rig import check_engine

        if self.mask is not None and self.mask.suffix.lower() not in MASKS:
            raise OptionError(
                f"apparel moves by 'auto', 'none', 'simulate', 'chains' or 'learn', or is named by a mask "
                f"({', '.join(MASKS)}), not '{self.motion}'; choose one of these"
            )
        STIFFNESS.check(self.stiffness, "--apparel-feel" if dashes else "stiffness")
        GRAVITY.check(self.gravity, f"{dashes}gravity")
        if self.motion in ("simulate", "chains"):
            check_engine(f"apparel that moves by '{self.motion}'")

    def check_with(self, constraints: Sequence[Constraint], handles: bool = False, dashes: str = "") -> None:
        """Whether apparel that moves so goes with the constraints, and with handles that are given or requested;
        OptionError where it does not.
        """
        kinds = {constraint.kind for constraint in constraints}
        if self.motion == "simulate" and kinds & {"path", "pin"}:
            raise OptionError(
                f"paths and pins are for characters moved by handles; leave out {dashes}apparel simulate, or "
                f"{dashes}path and {dashes}pin"
            )
        if self.moves and kinds & {"loop", "after"}:
            moving = "simulated" if self.motion == "simulate" else "moving"
            raise OptionError(
                f"{moving} apparel starts from the rest pose, so it goes with neither {dashes}loop nor {dashes}after"
            )
        if self.motion == "simulate" and handles:
            raise OptionError(f"apparel is simulated on the bones of a character's rig; leave {dashes}handles out")


CONSTRAINTS = {
    "path": "bunraku.core.travel:GroundPath",
    "pin": "bunraku.retarget.pins:Pin",
    "pose": "bunraku.pipelines.requests:Pose",
    "loop": "bunraku.pipelines.requests:Loop",
    "after": "bunraku.pipelines.requests:Follow",
    "in_place": "bunraku.pipelines.requests:InPlace",
    "keep": "bunraku.pipelines.requests:Keep",
}
"""The classes of constraints by their kinds."""
MOST_PINS = 100
_OF_A_CLIP = ("keep", "pose")
_MADE_ANEW = ("path", "loop", "after", "in_place")
_ROUND = "a loop ends where it starts, so it cannot follow another motion: {} and {} do not go together"


@dataclass(frozen=True)
class Loop(Constraint, kind="loop", alone=(("after",), _ROUND)):
    """The last pose equals the first, at another position where the motion travels."""


@dataclass(frozen=True)
class InPlace(Constraint, kind="in_place"):
    """The travel over the ground is removed, for game engines that move the character themselves."""


@dataclass(frozen=True, eq=False)
class Follow(Constraint, kind="after"):
    """The motion starts in the last pose of another."""

    # An animation of the same character, or a motion of the reference body; or its name in a JSON form, whose reader
    # opens it.
    clip: HandleMotion | AnimatedCharacter | str

    @classmethod
    def from_json(cls, data: object) -> Self:
        """The constraint of a JSON form, which names the clip."""
        if isinstance(data, dict):
            data = {key: value for key, value in data.items() if key != "kind"}
        return cls(from_json(_Named, data, "what is followed").clip)


@dataclass(frozen=True)
class _Named:
    clip: str


@dataclass(frozen=True)
class Keep(Constraint, kind="keep"):
    """What stays of a clip while the rest is generated: parts of the body, and everything outside a span of time."""

    parts: tuple[str, ...] = ()  # such as legs, left arm, upper body (`body.parts`)
    span: tuple[float, float] | None = None  # the first and the last second that are generated; None is all of the clip


@dataclass(frozen=True)
class Pose(Constraint, kind="pose", several=True):
    """A single pose of a clip that stays; what is between such poses is generated."""

    time: Annotated[float, MOMENT]  # seconds from the start of the clip
    take: str | None = None  # the name of the clip that the pose comes from; None is the clip itself
    at: Annotated[float | None, MOMENT] = None  # seconds from the start of that clip; None is `time`


class Constraints(tuple[Constraint, ...]):
    """All constraints of a request."""

    __slots__ = ()

    @classmethod
    def of(
        cls, *, loop: bool = False, in_place: bool = False,
        after: HandleMotion | AnimatedCharacter | str | None = None,
        path: GroundPath | Sequence[Sequence[float]] | None = None, pins: Iterable[Pin] = (),
    ) -> Self:  # fmt: skip
        """Those of a motion that is made anew; arguments as in `bunraku.animate`."""
        if path is not None and not isinstance(path, Constraint):
            path = ground_path(path)
        follow = None if after is None else Follow(after)
        given = (Loop() if loop else None, InPlace() if in_place else None, follow, path)
        return cls((*(constraint for constraint in given if constraint is not None), *pins))

    @property
    def path(self) -> GroundPath | None:
        """What the root follows on the ground, in the character's metres."""
        return cast("GroundPath | None", self._one("path"))

    @property
    def pins(self) -> list[Pin]:
        """Where hands and feet are at some times."""
        return [cast("Pin", constraint) for constraint in self if constraint.kind == "pin"]

    @property
    def loop(self) -> bool:
        """Whether a loop is made."""
        return self._one("loop") is not None

    @property
    def in_place(self) -> bool:
        """Whether the path over the ground is taken out."""
        return self._one("in_place") is not None

    @property
    def after(self) -> HandleMotion | AnimatedCharacter | None:
        """The clip in whose last pose the motion starts; OptionError where it is named and not opened."""
        follow = cast("Follow | None", self._one("after"))
        if follow is None:
            return None
        if isinstance(follow.clip, str):
            raise OptionError(f"the clip '{follow.clip[:60]}' is only named; open it, and give the animation")
        return follow.clip

    def following(self, clip: HandleMotion | AnimatedCharacter) -> Self:
        """The same, following a clip in place of the one that was named."""
        return type(self)((*(constraint for constraint in self if constraint.kind != "after"), Follow(clip)))

    @property
    def keep(self) -> Keep:
        """What stays of a clip that is edited."""
        return cast("Keep | None", self._one("keep")) or Keep()

    @property
    def poses(self) -> list[Pose]:
        """Single poses that stay of a clip that is edited."""
        return [constraint for constraint in self if isinstance(constraint, Pose)]

    def _one(self, kind: str) -> Constraint | None:
        return next((constraint for constraint in self if constraint.kind == kind), None)

    def check(self, dashes: str = "", clip: bool = False) -> None:
        """Whether all go together, OptionError where they do not; `clip`: a clip is edited, and no motion made anew."""
        if len(self.pins) > MOST_PINS:
            raise OptionError(f"at most {MOST_PINS} pins are met, not {len(self.pins)}")
        for constraint in self:
            if constraint.kind in (_MADE_ANEW if clip else _OF_A_CLIP):
                raise OptionError(
                    f"'{constraint.kind}' is for clips that are {'made anew' if clip else 'edited'}; leave it out"
                )
            constraint.check(self, dashes)

    def to_json(self) -> list[dict[str, Any]]:
        """The JSON form: a list of those of all."""
        return [constraint.to_json() for constraint in self]

    @classmethod
    def from_json(cls, data: object) -> Self:
        """The constraints of a JSON form; OptionError where it is not such a form."""
        if not isinstance(data, list | tuple):
            raise OptionError("constraints must be a list")
        pins = []
        for form in data:
            kind = form.get("kind") if isinstance(form, dict) else None
            if not isinstance(kind, str) or kind not in CONSTRAINTS:
                raise OptionError(f"a constraint is an object with a kind: {', '.join(CONSTRAINTS)}")
            module, name = CONSTRAINTS[kind].split(":")
            pins.append(getattr(importlib.import_module(module), name).from_json(form))
        return cls(pins)


HANDLES = ("predict", "rig")
"""How handles are made where none are given."""
RIGS = ("auto", "own", "handles")
"""What of a character moves."""


def whole_number(name: str, value: Any) -> int:
    """A whole number of any type, such as numpy's; OptionError for other values."""
    try:
        return operator.index(value)
    except TypeError:
        raise OptionError(f"{name} must be a whole number, not {str(value)[:40]}") from None


def ground_path(points: Sequence[Sequence[float]]) -> GroundPath:
    """The path of points on the ground, each x and z [m]; OptionError for other values."""
    from bunraku.core.travel import GroundPath

    try:
        return GroundPath(tuple((float(x), float(z)) for x, z in points))
    except (TypeError, ValueError):
        raise OptionError("path is a GroundPath, or a list of points on the ground with x and z in metres") from None


@dataclass(frozen=True)
class Sampling:
    """How a motion is drawn from a sentence.

    Args:
        seconds: Length of the clip, at least 0.5, and at most 120 in one pass; prompts in a row without seconds of
            their own share it. Default: what fits the action: 6 for what goes on, such as walking, or with a path or a
            pin, and for what is done once as long as people take for it.
        seed: The same seed and version give the same motion.
        steps: Sampling steps, 1 to 1000; more is slower. Default: 4, to which the network was distilled.
        guidance: How closely to follow the sentence, 0 to 20. Default: 3.5.
        candidates: Motions that are drawn, 1 to 16; a ranker chooses the best.
    """

    seconds: float | None = None
    seed: int = 0
    steps: int | None = None
    guidance: float | None = None
    candidates: int = 3

    def __post_init__(self) -> None:
        for name in ("seed", "steps", "candidates"):
            value = getattr(self, name)
            if value is not None or name != "steps":
                object.__setattr__(self, name, whole_number(name, value))

    def check(self, dashes: str = "") -> None:
        """Whether a motion can be drawn so; `dashes` stand before the names of options in messages; OptionError where a
        number is outside its limits.
        """
        limits, numbers = (WHOLE, SEED, STEPS, GUIDANCE, CANDIDATES), (self.seconds, self.seed, self.steps)
        check_all(zip(limits, (*numbers, self.guidance, self.candidates), strict=True), dashes)


@dataclass(frozen=True, eq=False)
class Request:
    """What a character is to do.

    Args:
        sentence: In English or a language of `language.words`; several in a row with their seconds: "walks:4; jumps:2";
            or one that is parsed already (`language.parse`).
        sampling: How the motion is drawn.
        constraints: What it must meet: `GroundPath`, `Pin`, `Loop`, `Follow` and `InPlace` for a new motion, `Keep`,
            `Pose` and `Pin` for a clip that is edited.
        apparel: How hair and clothes move.
        stages: Which stages fit the motion to the character; the defaults when None.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        force: Go on where no movement of the sentence is understood.
        rig: What moves: "own" the bones of the file's skeleton, "handles" the 30 handles, "auto" the bones where they
            are understood as those of a person, of four legs or of a bird and no handles are requested, or else the
            handles.
    """

    sentence: str | Sentence
    sampling: Sampling = field(default_factory=Sampling)
    constraints: Constraints = field(default_factory=Constraints)
    apparel: Apparel = field(default_factory=Apparel)
    stages: Stages | None = None
    handles: Handles | Literal["predict", "rig"] = "predict"
    force: bool = False
    rig: Literal["auto", "own", "handles"] = "auto"

    def __post_init__(self) -> None:
        if not isinstance(self.constraints, Constraints):
            object.__setattr__(self, "constraints", Constraints(self.constraints))

    @property
    def prompt(self) -> str:
        """The sentence as it was typed."""
        return self.sentence if isinstance(self.sentence, str) else self.sentence.prompt

    @cached_property
    def parsed(self) -> Sentence:
        """The sentence, parsed; OptionError where it is refused, or a length is out of range."""
        from bunraku.language.parse import parse

        given = self.sentence
        return parse(given, self.seconds, self.force) if isinstance(given, str) else given

    @property
    def seconds(self) -> float | None:
        """The length that is asked for [s]; None where it follows from the sentence."""
        timed = any(constraint.kind in ("path", "pin") for constraint in self.constraints)
        return USUAL if timed and self.sampling.seconds is None else self.sampling.seconds

    def with_parsed(self) -> Request:
        """The same with its sentence parsed, which is then not parsed again."""
        return replace(self, sentence=self.parsed)

    def with_seed(self, seed: int) -> Request:
        """The same with another seed."""
        return replace(self, sampling=replace(self.sampling, seed=seed))

    def check(self, dashes: str = "", clip: bool = False) -> None:
        """Whether this can be requested; the sentence is checked where it is read. Arguments as in `Constraints.check`.

        Raises:
            OptionError: A number is outside its limits, or parts of the request do not go together.
        """
        self.sampling.check(dashes)
        self.apparel.check(dashes)
        check_handles(self.handles)
        self.constraints.check(dashes, clip)
        if self.rig not in RIGS:
            raise OptionError(f"what moves is 'auto', 'own' or 'handles', not '{self.rig}'; choose one of the three")
        if self.rig == "own" and self.handles_given:
            raise OptionError(f"handles are not bones of the file; leave out {dashes}rig own or {dashes}handles")
        self.apparel.check_with(self.constraints, self.handles_given or self.rig == "handles", dashes)

    @property
    def handles_given(self) -> bool:
        """Whether handles are given, or made in another way than by default."""
        return not isinstance(self.handles, str) or self.handles != "predict"

    def to_json(self) -> dict[str, Any]:
        """The JSON form; OptionError where it holds handles or a clip themselves, and not their names."""
        if not isinstance(self.handles, str):
            raise OptionError("handles that were made have no form in JSON; say how they are made: 'predict' or 'rig'")
        return {
            "sentence": self.prompt, "sampling": to_json(self.sampling),
            "constraints": self.constraints.to_json(), "apparel": to_json(self.apparel),
            "stages": None if self.stages is None else to_json(self.stages), "handles": self.handles,
            "force": self.force, "rig": self.rig,
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: object) -> Request:
        """The request of a JSON form, checked; OptionError where it is not such a form, or cannot be requested."""
        form = from_json(_Form, data, "the request")
        stages = None
        if form.stages is not None:
            from bunraku.retarget.stages import Stages

            stages = from_json(Stages, form.stages, "stages")
        constraints = Constraints.from_json(form.constraints)
        request = cls(
            form.sentence, form.sampling, constraints, form.apparel, stages, form.handles, form.force, form.rig
        )  # fmt: skip
        request.check(clip=any(constraint.kind in _OF_A_CLIP for constraint in constraints))
        return request


@dataclass(frozen=True)
class _Form:
    """The keys of a request's JSON form; `object` is read by another class."""

    sentence: str
    sampling: Sampling = field(default_factory=Sampling)
    constraints: tuple[object, ...] = ()
    apparel: Apparel = field(default_factory=Apparel)
    stages: object = None
    handles: Literal["predict", "rig"] = "predict"
    force: bool = False
    rig: Literal["auto", "own", "handles"] = "auto"


def check_handles(handles: object) -> None:
    """Raise OptionError unless these are handles, or a way to make them."""
    if isinstance(handles, str) and handles not in HANDLES:
        raise OptionError(f"handles are made by 'predict' or 'rig', not '{handles}'; choose one of the two")


ONTO = ("auto", "handles", "rig")
"""What of a character a motion goes onto."""
RATE = 30.0
"""Frames a second [1/s] of what is transferred, unless another rate is requested."""


@dataclass(frozen=True, eq=False)
class TransferRequest:
    """How a motion is put on a character."""

    # "handles" moves the 30 handles of the character, "rig" the bones of its own rig, "auto" the rig of a humanoid that
    # has one and handles otherwise.
    onto: Literal["auto", "handles", "rig"] = "auto"
    apparel: Apparel = field(default_factory=Apparel)  # how hair and clothes move
    stages: Stages | None = None  # which stages run; `pipelines.transfer.TRANSFER_STAGES` when None
    # The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
    handles: Handles | Literal["predict", "rig"] = "predict"
    fps: float = RATE  # frames a second of the result [1/s]
    # The skeleton's joint by SMPL's name, for joints that are missed or mistaken; "" for none.
    names: Mapping[str, str] | None = None
    clip: int | str = 0  # number or name of the clip of a file with several

    def check(self, dashes: str = "") -> None:
        """Raise OptionError unless this can be requested; `dashes` stand before the names of options in messages."""
        if self.onto not in ONTO:
            raise OptionError(
                f"a motion goes onto 'handles', 'rig' or 'auto', not '{self.onto}'; choose one of the three"
            )
        FPS.check(self.fps, f"{dashes}fps" if dashes else "")
        check_handles(self.handles)
        self.apparel.check(dashes)
        if self.apparel.motion == "simulate" and self.onto == "handles":
            raise OptionError(f"apparel is simulated on the bones of a character's rig; leave out {dashes}onto handles")


LONGEST = 60
"""Letters of a clip's name."""


def clip_names(prompts: Iterable[str]) -> dict[str, str]:
    """Prompts by the names of their clips: the name before a prompt, or its words, "walks forward" as walks-forward; a
    second one of a name gets a number.
    """
    from bunraku.files import free_name
    from bunraku.language.prompts import split_name

    out: dict[str, str] = {}
    for prompt in prompts:
        name, sentence = split_name(prompt)
        words = "-".join(re.findall(r"\w+", sentence.split(";")[0].lower()))[:LONGEST].strip("-")
        out[free_name(name or words or "clip", out)] = sentence
    return out


def is_cycle(sentence: Sentence) -> bool:
    """Whether a sentence describes one movement that repeats, as walking does and jumping does not."""
    from bunraku.language.lexicon import is_cyclic

    if sentence.loop:
        return True
    if len(sentence.clauses) != 1:
        return False
    (clause,) = sentence.clauses
    if clause.turn is not None and (clause.turn.side or math.isfinite(clause.turn.most)):
        return False
    return all(map(is_cyclic, clause.actions)) if clause.actions else bool(clause.locomotion)


def with_loops(requests: Mapping[str, Request]) -> dict[str, Request]:
    """Requests, those made loops whose parsed sentence describes a cycle and whose constraints allow a loop."""
    from bunraku.language.sentence import Sentence

    loops: dict[int, Constraints] = {}
    out = {}
    for name, request in requests.items():
        given = request.constraints
        free = not request.apparel.moves and all(constraint.kind == "in_place" for constraint in given)
        if free and isinstance(request.sentence, Sentence) and is_cycle(request.sentence):
            closed = loops.setdefault(id(given), Constraints((Loop(), *given)))
            request = replace(request, constraints=closed)
        out[name] = request
    return out
