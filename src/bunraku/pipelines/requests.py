"""What is requested: a sentence or a motion, sampling, constraints, how apparel moves, and which of several clips are
loops.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, cast

from bunraku.core.request import (
    CANDIDATES,
    FPS,
    GRAVITY,
    GUIDANCE,
    SEED,
    STEPS,
    STIFFNESS,
    WHOLE,
    Constraint,
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

__all__ = [
    "APPAREL", "Apparel", "CONSTRAINTS", "Constraints", "Follow", "HANDLES", "InPlace", "Keep", "Loop", "ONTO",
    "Pose", "RATE", "RIGS", "Request", "Sampling", "TransferRequest", "check_handles", "clip_names", "is_cycle",
    "with_loops",
]  # fmt: skip


APPAREL = ("auto", "none", "rigid", "simulate", "chains", "learn")
"""How apparel may move, beside a mask; "rigid" is another word for "none"."""
MASKS = (".npy", ".txt", ".ply", ".glb")


@dataclass(frozen=True)
class Apparel:
    """How hair and clothes move.

    Args:
        motion: "none" (or "rigid") moves them with the body; "simulate" by the rigid bodies or springs of an MMD or VRM
            file, or else by the bones of hair and clothes of a person's rig; "chains" by chains of bones that are laid
            over what a network finds on any mesh, and simulated; "learn" by a network; "auto" by the file's physics, or
            else its bones, or else chains where the mesh has apparel; or the file of a mask of what is to be
            learned.
        stiffness: How stiff apparel is, as a factor, 0.001 to 1000.
        gravity: How strongly what is simulated is drawn downwards, as a factor, 0 to 10.
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
        """Whether apparel can move so.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It cannot.
            MissingExtraError: What simulates is not installed.
        """
        from bunraku.apparel.physics.rig import check_engine

        if self.mask is not None and self.mask.suffix.lower() not in MASKS:
            raise OptionError(
                f"apparel moves by 'auto', 'none', 'simulate', 'chains' or 'learn', or is named by a mask "
                f"({', '.join(MASKS)}), not '{self.motion}'; choose one of these"
            )
        STIFFNESS.check(self.stiffness, f"{dashes}stiffness")
        GRAVITY.check(self.gravity, f"{dashes}gravity")
        if self.motion in ("simulate", "chains"):
            check_engine(f"apparel that moves by '{self.motion}'")

    def check_with(self, constraints: Sequence[Constraint], handles: bool = False, dashes: str = "") -> None:
        """Whether apparel that moves so goes together with what a motion must meet.

        Args:
            constraints: Those of a request.
            handles: Whether handles are given or requested.
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It does not.
        """
        kinds = {one.kind for one in constraints}
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


@dataclass(frozen=True)
class Loop(Constraint):
    """The last pose is the first again, at another place where the motion travels."""

    kind: ClassVar[str] = "loop"
    alone: ClassVar[tuple[tuple[str, ...], str]] = (
        ("after",),
        "a loop ends where it starts, so it cannot follow another motion: {} and {} do not go together",
    )


@dataclass(frozen=True)
class InPlace(Constraint):
    """The path over the ground is taken out, as game engines want it that move the character themselves."""

    kind: ClassVar[str] = "in_place"


@dataclass(frozen=True, eq=False)
class Follow(Constraint):
    """The motion starts in the last pose of another.

    Args:
        clip: An animation of the same character, or a motion of the reference body; or the name of one, as a JSON form
            has it, which whoever reads that form opens.
    """

    clip: HandleMotion | AnimatedCharacter | str

    kind: ClassVar[str] = "after"

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
class Keep(Constraint):
    """What of a clip stays as it is while the rest is generated: parts of the body, and all outside a span of time.

    Args:
        parts: Such as legs, left arm, upper body (`body.parts`); none keeps no part.
        span: Seconds from and to which is generated; None is all of the clip.
    """

    parts: tuple[str, ...] = ()
    span: tuple[float, float] | None = None

    kind: ClassVar[str] = "keep"


@dataclass(frozen=True)
class Pose(Constraint):
    """A single pose of a clip that stays as it is; what is between such poses is generated.

    Args:
        time: Seconds from the start of the clip.
        take: The name of another clip that it is taken from; None is the clip itself.
        at: Seconds from the start of that clip; None is `time`.
    """

    time: float
    take: str | None = None
    at: float | None = None

    kind: ClassVar[str] = "pose"
    several: ClassVar[bool] = True


class Constraints(tuple[Constraint, ...]):
    """All constraints of a request."""

    __slots__ = ()

    @classmethod
    def of(
        cls,
        *,
        loop: bool = False,
        in_place: bool = False,
        after: HandleMotion | AnimatedCharacter | str | None = None,
        path: GroundPath | None = None,
        pins: Iterable[Pin] = (),
    ) -> Self:
        """Those of a motion that is made anew; arguments as of `bunraku.animate`."""
        found: list[Constraint] = [*((Loop(),) if loop else ()), *((InPlace(),) if in_place else ())]
        found += [] if after is None else [Follow(after)]
        return cls((*found, *([] if path is None else [path]), *pins))

    @property
    def path(self) -> GroundPath | None:
        """What the root follows on the ground, in the character's metres."""
        return cast("GroundPath | None", self._one("path"))

    @property
    def pins(self) -> list[Pin]:
        """Where hands and feet are at some times."""
        return [cast("Pin", one) for one in self if one.kind == "pin"]

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
        """The clip in whose last pose the motion starts.

        Raises:
            OptionError: It is named and not opened.
        """
        found = self._one("after")
        if not isinstance(found, Follow):
            return None
        if isinstance(found.clip, str):
            raise OptionError(f"the clip '{found.clip[:60]}' is only named; open it, and give the animation")
        return found.clip

    def following(self, clip: HandleMotion | AnimatedCharacter) -> Self:
        """The same with the clip itself that is only named, or another one, followed."""
        return type(self)((*(one for one in self if one.kind != "after"), Follow(clip)))

    @property
    def keep(self) -> Keep:
        """What stays of a clip that is edited."""
        found = self._one("keep")
        return found if isinstance(found, Keep) else Keep()

    @property
    def poses(self) -> list[Pose]:
        """Single poses that stay of a clip that is edited."""
        return [one for one in self if isinstance(one, Pose)]

    def _one(self, kind: str) -> Constraint | None:
        return next((one for one in self if one.kind == kind), None)

    def check(self, dashes: str = "", clip: bool = False) -> None:
        """Whether all go together.

        Args:
            dashes: What stands before the names of options in messages.
            clip: Whether a clip is edited, and no motion made anew.

        Raises:
            OptionError: They do not.
        """
        if len(self.pins) > MOST_PINS:
            raise OptionError(f"at most {MOST_PINS} pins are met, not {len(self.pins)}")
        for one in self:
            if one.kind in (_MADE_ANEW if clip else _OF_A_CLIP):
                raise OptionError(
                    f"'{one.kind}' is for clips that are {'made anew' if clip else 'edited'}; leave it out"
                )
            one.check(self, dashes)

    def to_json(self) -> list[dict[str, Any]]:
        """The JSON form: a list of those of all."""
        return [one.to_json() for one in self]

    @classmethod
    def from_json(cls, data: object) -> Self:
        """The constraints of a JSON form.

        Raises:
            OptionError: It is none.
        """
        if not isinstance(data, list | tuple):
            raise OptionError("constraints must be a list")
        found = []
        for one in data:
            kind = one.get("kind") if isinstance(one, dict) else None
            if not isinstance(kind, str) or kind not in CONSTRAINTS:
                raise OptionError(f"a constraint is an object with a kind: {', '.join(CONSTRAINTS)}")
            module, name = CONSTRAINTS[kind].split(":")
            found.append(getattr(importlib.import_module(module), name).from_json(one))
        return cls(found)


HANDLES = ("predict", "rig")
"""How handles are made where none are given."""
RIGS = ("auto", "own", "handles")
"""What of a character moves."""


@dataclass(frozen=True)
class Sampling:
    """How a motion is drawn from a sentence.

    Args:
        seconds: Length of the clip, at least 0.5, and at most 120 in one pass; prompts in a row without seconds of
            their own share it.
        seed: The same seed and version give the same motion.
        steps: Sampling steps, 1 to 1000; more is slower. Default: 4, which the network was distilled into.
        guidance: How closely to follow the sentence, 0 to 20. Default: 3.5.
        candidates: Motions that are drawn, of which the one is taken that a ranker likes best, 1 to 16; 1 is the
            fastest.
    """

    seconds: float = 6.0
    seed: int = 0
    steps: int | None = None
    guidance: float | None = None
    candidates: int = 3

    def check(self, dashes: str = "") -> None:
        """Whether a motion can be drawn so.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: A number is outside its limits.
        """
        WHOLE.check(self.seconds, f"{dashes}seconds")
        SEED.check(self.seed, f"{dashes}seed")
        STEPS.check(self.steps, f"{dashes}steps")
        GUIDANCE.check(self.guidance, f"{dashes}guidance")
        CANDIDATES.check(self.candidates, f"{dashes}candidates")


@dataclass(frozen=True, eq=False)
class Request:
    """What a character is to do.

    Args:
        sentence: In English or a language of `language.words`; several in a row with their seconds: "walks:4; jumps:2".
            One that is parsed already (`language.parse`) is not parsed again.
        sampling: How the motion is drawn.
        constraints: What it must meet: a `GroundPath`, `Pin`, `Loop`, `Follow`, `InPlace`; of a clip that is edited a
            `Keep`, `Pose`, `Pin`.
        apparel: How hair and clothes move.
        stages: Which stages fit the motion to the character; the defaults when None.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        force: Go on even where no movement of the sentence is understood.
        rig: What moves: "own" the bones of the file's skeleton, "handles" the 30 handles, "auto" the bones where they
            are understood as those of a person, of four legs or of a bird and no handles are requested, and handles
            otherwise.
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
        """The sentence, parsed.

        Raises:
            OptionError: It is empty, too long or not understood, or a length is out of range.
        """
        from bunraku.language.parse import parse

        given = self.sentence
        return parse(given, self.sampling.seconds, self.force) if isinstance(given, str) else given

    def with_parsed(self) -> Request:
        """The same with its sentence parsed, which is then not parsed again."""
        return replace(self, sentence=self.parsed)

    def with_seed(self, seed: int) -> Request:
        """The same with another seed."""
        return replace(self, sampling=replace(self.sampling, seed=seed))

    def check(self, dashes: str = "", clip: bool = False) -> None:
        """Whether this can be requested; what the sentence says is checked where it is read.

        Args:
            dashes: What stands before the names of options in messages.
            clip: Whether a clip is edited.

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
            raise OptionError(f"handles are no bones of the file; leave out {dashes}rig own or {dashes}handles")
        self.apparel.check_with(self.constraints, self.handles_given or self.rig == "handles", dashes)

    @property
    def handles_given(self) -> bool:
        """Whether it says which handles there are, or that they are made in another way than by default."""
        return not isinstance(self.handles, str) or self.handles != "predict"

    def to_json(self) -> dict[str, Any]:
        """The JSON form.

        Raises:
            OptionError: It holds handles or a clip themselves, and not their names.
        """
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
        """The request of a JSON form, checked.

        Raises:
            OptionError: It is none, or cannot be requested.
        """
        form = from_json(_Form, data, "the request")
        stages = None
        if form.stages is not None:
            from bunraku.retarget.stages import Stages

            stages = from_json(Stages, form.stages, "stages")
        constraints = Constraints.from_json(form.constraints)
        found = cls(
            form.sentence, form.sampling, constraints, form.apparel, stages, form.handles, form.force, form.rig
        )  # fmt: skip
        found.check(clip=any(one.kind in ("keep", "pose") for one in constraints))
        return found


@dataclass(frozen=True)
class _Form:
    """The keys of a request's JSON form, with what is read by classes of its own as it is."""

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
    """How a motion is put on a character.

    Args:
        onto: "handles" moves the 30 handles of the character, "rig" the bones of its own rig, "auto" the rig of a
            humanoid that has one and handles otherwise.
        apparel: How hair and clothes move.
        stages: Which stages run; `pipelines.transfer.TRANSFER_STAGES` when None.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        fps: Frames a second of the result [1/s].
        names: The skeleton's joint by SMPL's name, for joints that are not found or found wrongly; "" for none.
        clip: Number or name of the clip of a file with several.
    """

    onto: Literal["auto", "handles", "rig"] = "auto"
    apparel: Apparel = field(default_factory=Apparel)
    stages: Stages | None = None
    handles: Handles | Literal["predict", "rig"] = "predict"
    fps: float = RATE
    names: Mapping[str, str] | None = None
    clip: int | str = 0

    def check(self, dashes: str = "") -> None:
        """Whether this can be requested.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It cannot.
        """
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
    """Prompts by the names of their clips: those that stand before them, or their words, "walks forward" as
    walks-forward; one that is there already gets a number.
    """
    from bunraku.files import free_name
    from bunraku.language.prompts import split_name

    out: dict[str, str] = {}
    for prompt in prompts:
        name, said = split_name(prompt)
        words = "-".join(re.findall(r"\w+", said.split(";")[0].lower()))[:LONGEST].strip("-")
        out[free_name(name or words or "clip", out)] = said
    return out


def is_cycle(sentence: Sentence) -> bool:
    """Whether a sentence tells of one thing that goes on as it is, as walking does and jumping does not."""
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
    """Requests of which those are loops whose sentences are parsed, tell of a cycle, and meet nothing that a loop does
    not go with.
    """
    from bunraku.language.sentence import Sentence

    loops: dict[int, Constraints] = {}
    out = {}
    for name, request in requests.items():
        own = request.constraints
        free = not request.apparel.moves and all(one.kind == "in_place" for one in own)
        if free and isinstance(request.sentence, Sentence) and is_cycle(request.sentence):
            closed = loops.setdefault(id(own), Constraints((Loop(), *own)))
            request = replace(request, constraints=closed)
        out[name] = request
    return out
