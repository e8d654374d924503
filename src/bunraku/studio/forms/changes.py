"""Takes that are made from one: parts kept, bent to pins, dressed anew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bunraku.core.request.json_form import to_json
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints, Keep, Pose
from bunraku.pipelines.requests.request import Request
from bunraku.studio.forms.drawing import TIME, Drawn, Motion, read_pins, stages_without
from bunraku.studio.forms.script import MOST_WORDS

__all__ = ["ChangeForm", "PoseForm"]


@dataclass(frozen=True)
class PoseForm:
    """A pose that stays.

    Args:
        time: Seconds of the clip.
        take: The take that it is of; None is the clip itself.
        at: Seconds of that take; None is `time`.
    """

    time: float = 0.0
    take: str | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        TIME.check(self.time)
        TIME.check(self.at, "at")


@dataclass(frozen=True, kw_only=True)
class ChangeForm(Drawn):
    """Takes that are made from one: parts kept and the rest generated, bent to pins, dressed anew, mirrored, trimmed.

    Args:
        prompt: What is done instead; nothing is generated where it is empty.
        keep: Parts that stay.
        span: Seconds from and to which is generated.
        poses: Poses that stay.
        apparel: How apparel moves, where that is to change.
        stiffness: How stiff apparel is.
        gravity: How strongly what is simulated is drawn downwards.
        mirror: Left and right are exchanged; nothing else is then changed.
        trim: Seconds from and to of what stays; all else goes.
    """

    prompt: str = ""
    keep: tuple[str, ...] = ()
    span: tuple[float, ...] | None = None
    poses: tuple[PoseForm, ...] = ()
    apparel: Motion | None = None
    stiffness: float = 1.0
    gravity: float = 1.0
    mirror: bool = False
    trim: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.prompt) > MOST_WORDS:
            raise OptionError(f"prompt has more than {MOST_WORDS} characters, {len(self.prompt):,}; say it in fewer")
        if len(self.span or ()) not in (0, 2):
            raise OptionError("a span is two seconds, from and to")
        for second in self.span or ():
            TIME.check(second, "span")
        for second in self.trim or ():
            TIME.check(second, "trim")
        if self.trim and self.trim[0] >= self.trim[1]:
            raise OptionError("trim is from an earlier second to a later one")

    def request(self, apparel: Apparel) -> Request:
        """The request of an edit, checked.

        Args:
            apparel: How the apparel of the take moves.

        Raises:
            OptionError: Nothing is kept, or the sentence is not understood.
        """
        from bunraku.body.parts import kept_handles

        if self.keep:
            kept_handles(self.keep)
        if not self.keep and not self.span and not self.poses:
            raise OptionError("nothing is kept: select a span of time, keep parts of the body, or pin poses")
        span = (self.span[0], self.span[1]) if self.span else None
        stays = [Keep(self.keep, span)] if self.keep or span else []
        poses = [Pose(pose.time, pose.take, pose.at) for pose in self.poses]
        found = Request(
            self.prompt.strip(), self.sampling(6.0), Constraints((*stays, *poses, *read_pins(self.pins))), apparel,
            stages_without(self.without), force=self.force,
        )  # fmt: skip
        found.check(clip=True)
        return found.with_parsed()

    def bends(self) -> Constraints:
        """Its pins, for a take that is bent to them."""
        return Constraints(read_pins(self.pins))

    def asked(self, apparel: Apparel) -> dict[str, Any]:
        """What a take's record keeps of it."""
        kept = ("seeds", "keep", "span", "poses", "pins", "prompt")
        return {**{name: to_json(getattr(self, name)) for name in kept}, "apparel": apparel.motion,
                "stiffness": apparel.stiffness, "gravity": apparel.gravity}  # fmt: skip
