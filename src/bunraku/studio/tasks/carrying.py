"""Takes of motion that is there already: bent, dressed, carried over from files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.studio.forms.drawing import DressForm, stages_without
from bunraku.studio.tasks.task import Partly, Report, of_handles, put_away
from bunraku.studio.workspace.clips import body_of
from bunraku.studio.workspace.dressing import check_fits, dressed_anew, put_on
from bunraku.studio.workspace.workspace import Workspace

__all__ = ["Bend", "Dress", "Mirror", "Transfer", "Trim"]


@dataclass(frozen=True)
class Bend(DressForm):
    """A take bent to its pins, with nothing generated."""

    character: str
    takes: tuple[str]
    parent: str
    constraints: tuple[object, ...]

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.retarget.stages.pins import meet_pins

        parent = of_handles(shop.take(self.parent, self.character))
        report("fit", 0.2)
        pins = Constraints.from_json(self.constraints).pins
        met = meet_pins(parent.motion, Anatomy.of(parent.character, parent.handles), pins)
        made = Animation(parent.character, parent.handles, met, parent.reference)
        take, (name,) = put_on(made, self.apparel_request, report), self.takes
        put_away(take, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Mirror(DressForm):
    """A take with left and right exchanged, fitted anew."""

    character: str
    takes: tuple[str]
    parent: str

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.diffusion.features import decode, encode, mirror
        from bunraku.pipelines.apply import apply_motion, reference_of

        parent = of_handles(shop.take(self.parent, self.character))
        report("fit", 0.2)
        anatomy = Anatomy.of(parent.character, parent.handles)
        motion = reference_of(parent, anatomy)
        mirrored = decode(mirror(encode(motion)), motion.fps)
        take, (name,) = apply_motion(mirrored, anatomy), self.takes
        dressed = put_on(take, self.apparel_request, report)
        put_away(dressed, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Trim(DressForm):
    """A stretch of a take, as it is there."""

    character: str
    takes: tuple[str]
    parent: str
    trim: tuple[float, float]

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        parent = body_of(shop.take(self.parent, self.character))
        start, stop = (round(second * parent.fps) for second in self.trim)
        if stop - start < 2 or start >= len(parent.motion):
            raise OptionError("nothing is left of the take; choose a longer stretch of it")
        take, (name,) = parent.take(slice(start, stop)), self.takes
        dressed = put_on(take, self.apparel_request, report)
        put_away(dressed, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Dress(DressForm):
    """A take of the same motion whose apparel moves otherwise."""

    character: str
    takes: tuple[str]
    parent: str
    in_place: bool = False
    without: tuple[str, ...] = ()

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        parent, (_, handles) = shop.take(self.parent, self.character), shop.character(self.character)
        made = dressed_anew(
            parent, self.apparel_request, handles, in_place=self.in_place,
            stages=stages_without(self.without), report=report,
        )  # fmt: skip
        (name,) = self.takes
        put_away(made, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Transfer(DressForm):
    """A take from a motion of a file."""

    character: str
    takes: tuple[str]
    file: str
    onto: Literal["auto", "handles"] = "handles"

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.requests.transfer import TransferRequest
        from bunraku.pipelines.transfer import Source, transferred

        (name,) = self.takes
        character, handles = shop.character(self.character)
        source = Source(shop.folder_of("takes", name) / self.file)
        apparel, animator = self.apparel_request, Animator.shipped(report)
        check_fits(apparel, character, 0)
        take = None
        if apparel.moves or self.onto == "auto":
            own = apparel if apparel.motion == "simulate" else Apparel()
            take = transferred(animator, character, source, TransferRequest(apparel=own))
        if not isinstance(take, RigAnimation):  # on the handles that the studio shows
            take = transferred(animator, character, source, TransferRequest("handles", handles=handles))
        assert isinstance(take, Animation | RigAnimation)
        apparel = Apparel() if apparel.motion == "simulate" else apparel  # simulated already
        put_away(put_on(take, apparel, report), name, self.character, shop, partly)
        return {"takes": [name]}
