"""Tasks that make takes: from sentences, from motion that exists, and from clips of the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.predict import Predictor
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.files import atomic_write
from bunraku.core.motion import HandleMotion, resample
from bunraku.core.request import Progress
from bunraku.errors import OptionError
from bunraku.generation.features import decode, encode
from bunraku.generation.library import clip as find_clip
from bunraku.generation.library import features_of
from bunraku.generation.splicing import splice
from bunraku.pipelines.animator import Animator, Body
from bunraku.pipelines.apply import apply_motion, reference_of
from bunraku.pipelines.requests import Apparel, Constraints, Follow, Request, TransferRequest
from bunraku.pipelines.transfer import TRANSFER_STAGES, transferred
from bunraku.retarget.fit import Stages
from bunraku.studio.dressing import check_fits, dress_take, redress_take
from bunraku.studio.forms import DressForm, stages_without
from bunraku.studio.wire import Take, body_of, packed_clip
from bunraku.studio.workspace import PREVIEWS, Workspace

__all__ = [
    "Animate", "Bend", "DRAFT_STAGES", "Dress", "Edit", "Known", "Mirror", "Partly", "Play", "Preview",
    "Task", "Transfer", "Trim", "finish_take", "handle_animation_of",
]  # fmt: skip
Partly = Callable[[dict[str, Any]], None]


class Task(Protocol):
    """Something that the worker does."""

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        """Do it; give what its record learns."""


def handle_animation_of(take: Take) -> Animation:
    """What moves the handles of a take.

    Raises:
        OptionError: It moves the bones of its file.
    """
    body = body_of(take)
    if not isinstance(body, Animation):
        raise OptionError("this take moves the bones of the file; make one that moves handles to change it")
    return body


def finish_take(take: Take, name: str, owner: str, shop: Workspace, partly: Partly) -> None:
    """Write a take that is finished, and tell so.

    Args:
        take: The take.
        name, owner: Ids of the take and of its character.
        shop: Where it is written.
        partly: Called with what its record learns.
    """
    partly({"take": name, "state": "done", **shop.keep(take, name, owner)})


FPS = 20.0
"""What the network knows; takes of other rates, carried over from files, are resampled before they are changed."""
DRAFT_STAGES = Stages(smooth=False, feet=False, hands_clear=False, floor=False)
"""Of a draft, which is there to be seen at once."""


@dataclass(frozen=True)
class Known(Predictor):
    """What is known of a character that is open."""

    handles: Handles | None = None

    def feature(self, character: Character) -> np.ndarray:
        found = None if self.handles is None else self.handles.features
        return super().feature(character) if found is None else found


@dataclass(frozen=True)
class Animate:
    """Takes of one sentence: a draft first, then all in full."""

    character: str
    takes: tuple[str, ...]
    seeds: tuple[int, ...]
    request: object
    draft: bool = True

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator, own_rig

        body = shop.body(self.character)
        character, handles = body.character, body.anatomy.handles
        request = _followed(shop, Request.from_json(self.request), self.character)
        check_fits(request.apparel, character, request.sampling.seconds)
        moved: Body | Character = character
        if own_rig(character, request) is None:
            request, moved = replace(request, handles=handles), body

        def quickly(stage: str, done: float) -> None:
            report("draft", 0.02 + 0.04 * done)

        if self.draft:
            report("draft", 0.02)
            sampling = replace(request.sampling, seed=self.seeds[0], steps=None, guidance=None, candidates=1)
            quick = replace(
                request, sampling=sampling, apparel=Apparel(), stages=DRAFT_STAGES, handles=handles, rig="handles"
            )  # fmt: skip
            (draft,) = Animator(Known(handles=handles), progress=quickly).moved(body, [quick])
            partly({"take": self.takes[0], **shop.keep(draft, self.takes[0], self.character, draft=True)})
        ranges = {"generate": (0.1, 0.6), "fit": (0.7, 0.1)}

        def whole(stage: str, done: float) -> None:
            start, share = ranges.get(stage, (0.8, 0.2))
            report(stage, start + share * done)

        requests = [request.with_seed(seed) for seed in self.seeds]
        bodies = Animator(Known(handles=handles), progress=whole).moved(moved, requests)
        for name, made in zip(self.takes, bodies, strict=True):
            take = dress_take(made, request.apparel, whole)
            finish_take(take, name, self.character, shop, partly)
        return {"takes": list(self.takes)}


def _followed(shop: Workspace, request: Request, owner: str) -> Request:
    """The request with the take opened that it follows."""
    for one in request.constraints:
        if isinstance(one, Follow) and isinstance(one.clip, str):
            before = body_of(shop.take(one.clip, owner))
            return replace(request, constraints=request.constraints.following(before))
    return request


@dataclass(frozen=True)
class Edit:
    """A take with parts of another kept, for each seed."""

    character: str
    takes: tuple[str, ...]
    seeds: tuple[int, ...]
    parent: str
    request: object

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animate import edited
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.apply import GENERATED_STAGES

        request = Request.from_json(self.request)
        request = replace(request, stages=request.stages or GENERATED_STAGES)
        clip = handle_animation_of(shop.take(self.parent, self.character)).at(FPS)
        for pose in request.constraints.poses:
            at = pose.time if pose.at is None else pose.at
            if pose.take and (pose.take != self.parent or at != pose.time):
                clip = _with_pose(clip, shop.take(pose.take, self.character), pose.time, at)
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):

            def ahead(stage: str, done: float, number: int = number) -> None:
                report(stage, (number + 0.9 * done) / len(self.takes))

            made = edited(Animator.shipped(ahead), clip, request.with_seed(seed))
            take = dress_take(made, request.apparel, report)
            finish_take(take, name, self.character, shop, partly)
        return {"takes": list(self.takes)}


def _with_pose(clip: Animation, source: Take, time: float, at: float) -> Animation:
    """The clip with one frame taken from another at that one's place in it, heading and way of the clip kept."""
    from bunraku.core.travel import placed_at
    from bunraku.pipelines.apply import reference_of

    source = handle_animation_of(source)
    frame = min(round(time * clip.fps), len(clip.motion) - 1)
    there = min(round(at * source.fps), len(source.motion) - 1)

    def patched(motion: HandleMotion, other: HandleMotion) -> HandleMotion:
        one = placed_at(other.take(slice(there, there + 1)), 0, motion, frame)
        arrays = {name: np.array(getattr(motion, name)) for name in HandleMotion.arrays}
        for name, array in arrays.items():
            array[frame] = getattr(one, name)[0]
        return motion.with_arrays(arrays)

    return Animation(
        clip.character, clip.handles, patched(clip.motion, source.motion),
        patched(reference_of(clip), reference_of(source)),
    )  # fmt: skip


@dataclass(frozen=True)
class Bend(DressForm):
    """A take bent to its pins, with nothing generated."""

    character: str
    takes: tuple[str]
    parent: str
    constraints: tuple[object, ...]

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.retarget.pins import meet_pins

        parent = handle_animation_of(shop.take(self.parent, self.character))
        report("fit", 0.2)
        pins = Constraints.from_json(self.constraints).pins
        met = meet_pins(parent.motion, Anatomy.of(parent.character, parent.handles), pins)
        made = Animation(parent.character, parent.handles, met, parent.reference)
        take, (name,) = dress_take(made, self.apparel_request, report), self.takes
        finish_take(take, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Mirror(DressForm):
    """A take with left and right exchanged, fitted anew."""

    character: str
    takes: tuple[str]
    parent: str

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.generation.features import decode, encode, mirror
        from bunraku.pipelines.apply import apply_motion, reference_of

        parent = handle_animation_of(shop.take(self.parent, self.character))
        report("fit", 0.2)
        anatomy = Anatomy.of(parent.character, parent.handles)
        motion = reference_of(parent, anatomy)
        mirrored = decode(mirror(encode(motion)), motion.fps)
        take, (name,) = apply_motion(mirrored, anatomy), self.takes
        dressed = dress_take(take, self.apparel_request, report)
        finish_take(dressed, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Trim(DressForm):
    """A stretch of a take, as it is there."""

    character: str
    takes: tuple[str]
    parent: str
    trim: tuple[float, float]

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        parent = body_of(shop.take(self.parent, self.character))
        start, stop = (round(second * parent.fps) for second in self.trim)
        if stop - start < 2 or start >= len(parent.motion):
            raise OptionError("nothing is left of the take; choose a longer stretch of it")
        take, (name,) = parent.take(slice(start, stop)), self.takes
        dressed = dress_take(take, self.apparel_request, report)
        finish_take(dressed, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Dress(DressForm):
    """A take of the same motion whose apparel moves otherwise."""

    character: str
    takes: tuple[str]
    parent: str
    in_place: bool = False
    without: tuple[str, ...] = ()

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        parent, (_, handles) = shop.take(self.parent, self.character), shop.character(self.character)
        made = redress_take(
            parent, self.apparel_request, handles, in_place=self.in_place,
            stages=stages_without(self.without), report=report,
        )  # fmt: skip
        (name,) = self.takes
        finish_take(made, name, self.character, shop, partly)
        return {"takes": [name]}


@dataclass(frozen=True)
class Transfer(DressForm):
    """A take from a motion of a file."""

    character: str
    takes: tuple[str]
    file: str
    onto: Literal["auto", "handles"] = "handles"

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.requests import TransferRequest
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
        finish_take(dress_take(take, apparel, report), name, self.character, shop, partly)
        return {"takes": [name]}


PREVIEW_FPS = 10.0
BLEND = 8
"""Frames over which one part goes over into the next."""


@dataclass(frozen=True)
class Piece:
    """A part of a take: a clip of the library, or a request.

    Args:
        seconds: How long it lasts.
        clip: Its name; "" for a request.
        request: The JSON form of a request of one sentence or several.
    """

    seconds: float
    clip: str = ""
    request: object = None


@dataclass(frozen=True)
class Play(DressForm):
    """Takes in which clips and sentences follow each other, each from where the one before ends."""

    character: str
    takes: tuple[str, ...]
    seeds: tuple[int, ...]
    pieces: tuple[Piece, ...]
    constraints: tuple[object, ...] = ()

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        body = shop.body(self.character)
        character, handles, anatomy = body.character, body.anatomy.handles, body.anatomy
        apparel, constraints = self.apparel_request, Constraints.from_json(self.constraints)
        check_fits(apparel, character, sum(piece.seconds for piece in self.pieces))
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):

            def ahead(stage: str, done: float, number: int = number) -> None:
                report(stage, (number + 0.9 * done) / len(self.takes))

            animator = Animator(Known(handles=handles), progress=ahead)
            motion = self._reference(animator, body, seed, constraints.loop)
            if apparel.motion == "simulate":
                take: Any = transferred(animator, character, motion, TransferRequest(apparel=apparel))
            else:
                take = dress_take(apply_motion(motion, anatomy, constraints, TRANSFER_STAGES), apparel, ahead)
            finish_take(take, name, self.character, shop, partly)
        return {"takes": list(self.takes)}

    def _reference(self, animator: Animator, body: Body, seed: int, loop: bool) -> HandleMotion:
        """The motion of the reference body."""
        anatomy = body.anatomy
        features: np.ndarray | None = None
        for piece in self.pieces:
            if piece.clip:
                own = features_of(find_clip(piece.clip).stretch, piece.seconds, loop)
            else:
                request = replace(Request.from_json(piece.request).with_seed(seed), handles=anatomy.handles)
                if features is not None:
                    before = apply_motion(decode(features), anatomy, stages=DRAFT_STAGES)
                    request = replace(request, constraints=request.constraints.following(before))
                (made,) = animator.moved(body, [request])
                assert isinstance(made, Animation)  # its handles are given
                own = encode(reference_of(made, anatomy))
            features = own if features is None else _joined(features, own)
        assert features is not None  # a script has a part
        return decode(features)


def _joined(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """A motion and the next, as long as both: the last pose of the one is held while the other begins."""
    blend = min(BLEND, len(other), len(one))
    held = np.repeat(one[-1:], blend, axis=0)
    held[:, :3] = 0
    return splice(np.concatenate([one, held]), other, len(one), 0, blend)


@dataclass(frozen=True)
class Preview:
    """How clips look on a character: as its `PREVIEWS` has them, quickly fitted."""

    character: str
    clips: tuple[str, ...]

    def __call__(self, shop: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        anatomy = shop.body(self.character).anatomy
        folder = shop.folder_of("characters", self.character) / PREVIEWS
        for number, name in enumerate(self.clips):
            report("fit", number / len(self.clips))
            path = folder / f"{name}.bin"
            if path.is_file():
                continue
            clip = find_clip(name)
            motion = decode(features_of(clip.stretch, clip.seconds if clip.loops else None, clip.loops))
            made = apply_motion(motion, anatomy, Constraints.of(loop=clip.loops), DRAFT_STAGES)
            folder.mkdir(exist_ok=True)
            with atomic_write(path) as file:
                file.write(packed_clip(replace(made, motion=resample(made.motion, PREVIEW_FPS))))
        return {"clips": list(self.clips)}
