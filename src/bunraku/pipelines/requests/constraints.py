"""Constraints of a request, beside a path (`core.ground_path`) and pins (`retarget.stages.pins`)."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

from bunraku.core.request.constraint import Constraint
from bunraku.core.request.json_form import from_json
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.ground_path import GroundPath
    from bunraku.core.motion import HandleMotion
    from bunraku.retarget.stages.pins import Pin

__all__ = ["CONSTRAINTS", "Constraints", "Follow", "InPlace", "Keep", "Loop", "Pose"]

CONSTRAINTS = {
    "path": "bunraku.core.ground_path:GroundPath",
    "pin": "bunraku.retarget.stages.pins:Pin",
    "pose": "bunraku.pipelines.requests.constraints:Pose",
    "loop": "bunraku.pipelines.requests.constraints:Loop",
    "after": "bunraku.pipelines.requests.constraints:Follow",
    "in_place": "bunraku.pipelines.requests.constraints:InPlace",
    "keep": "bunraku.pipelines.requests.constraints:Keep",
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
