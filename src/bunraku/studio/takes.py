"""Tasks that make takes: from sentences, from motion that exists, and from clips of the library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from bunraku.core.travel import placed_at
from bunraku.errors import OptionError
from bunraku.generation.composition import splice
from bunraku.generation.features import decode, encode, mirror
from bunraku.generation.library import clip as find_clip
from bunraku.generation.library import features_of
from bunraku.pipelines.animate import edited
from bunraku.pipelines.animator import Animator, Body, own_rig
from bunraku.pipelines.apply import GENERATED_STAGES, apply_motion, reference_of
from bunraku.pipelines.requests import Apparel, Constraints, Follow, Request, TransferRequest
from bunraku.pipelines.transfer import TRANSFER_STAGES, Source, transferred
from bunraku.retarget.fit import Stages
from bunraku.retarget.pins import meet_pins
from bunraku.studio.dressing import check_fits, dress_take, redress_take
from bunraku.studio.forms import DressForm
from bunraku.studio.wire import Take, body_of, packed_clip
from bunraku.studio.workspace import PREVIEWS, Workspace

Partly = Callable[[dict[str, Any]], None]


class Task(Protocol):
    """A task of the worker."""

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        """Do it, and give what its record learns."""


def handle_animation_of(take: Take) -> Animation:
    """What moves the handles of a take; OptionError where it moves the bones of its file."""
    body = body_of(take)
    if not isinstance(body, Animation):
        raise OptionError("this take moves the bones of the file; make one that moves handles to change it")
    return body


def finish_takes(takes: Mapping[str, Take], owner: str, workspace: Workspace, partly: Partly) -> dict[str, Any]:
    """Write finished takes of a character, by their ids, which are given back; `partly` is called with what each record
    learns.
    """
    for name in takes:
        partly({"take": name, "state": "done", **workspace.keep(takes[name], name, owner)})
    return {"takes": list(takes)}


FPS = 20.0
"""The network's rate [1/s]; takes of other rates, from files, are resampled before they are changed."""
DRAFT_STAGES = Stages(smooth=False, feet=False, hands_clear=False, floor=False)
"""Stages of a draft, which is shown at once."""


@dataclass(frozen=True)
class Known(Predictor):
    """What is known of a character that is open."""

    handles: Handles | None = None

    def feature(self, character: Character) -> np.ndarray:
        features = None if self.handles is None else self.handles.features
        return super().feature(character) if features is None else features


@dataclass(frozen=True)
class Animate:
    """Takes of one sentence: a draft first, then all in full."""

    character: str
    takes: tuple[str, ...]
    seeds: tuple[int, ...]
    request: object
    draft: bool = True

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        body = workspace.body(self.character)
        character, handles = body.character, body.anatomy.handles
        request = _followed(workspace, Request.from_json(self.request), self.character)
        check_fits(request.apparel, character, request.parsed.seconds)
        moved: Body | Character = character
        if own_rig(character, request, lambda: body.anatomy) is None:
            request, moved = replace(request, handles=handles), body

        if self.draft:
            report("draft", 0.02)
            sampling = replace(request.sampling, seed=self.seeds[0], steps=None, guidance=None, candidates=1)
            quick = replace(
                request, sampling=sampling, apparel=Apparel(), stages=DRAFT_STAGES, handles=handles, rig="handles"
            )  # fmt: skip
            animator = Animator(Known(handles=handles), progress=lambda _, done: report("draft", 0.02 + 0.04 * done))
            (draft,) = animator.moved(body, [quick])
            partly({"take": self.takes[0], **workspace.keep(draft, self.takes[0], self.character, draft=True)})
        ranges = {"generate": (0.1, 0.6), "fit": (0.7, 0.1)}

        def whole(stage: str, done: float) -> None:
            start, share = ranges.get(stage, (0.8, 0.2))
            report(stage, start + share * done)

        requests = [request.with_seed(seed) for seed in self.seeds]
        bodies = Animator(Known(handles=handles), progress=whole).moved(moved, requests)
        for name, motion in zip(self.takes, bodies, strict=True):
            finish_takes({name: dress_take(motion, request.apparel, whole)}, self.character, workspace, partly)
        return {"takes": list(self.takes)}


def _one_of(report: Progress, number: int, count: int) -> Progress:
    """How far one of several takes is, as a share of all."""
    return lambda stage, done: report(stage, (number + 0.9 * done) / count)


def _followed(workspace: Workspace, request: Request, owner: str) -> Request:
    """The request with the take opened that it follows."""
    for constraint in request.constraints:
        if isinstance(constraint, Follow) and isinstance(constraint.clip, str):
            before = body_of(workspace.take(constraint.clip, owner))
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

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        request = Request.from_json(self.request)
        request = replace(request, stages=request.stages or GENERATED_STAGES)
        clip = handle_animation_of(workspace.take(self.parent, self.character)).at(FPS)
        for pose in request.constraints.poses:
            at = pose.time if pose.at is None else pose.at
            if pose.take and (pose.take != self.parent or at != pose.time):
                clip = _with_pose(clip, workspace.take(pose.take, self.character), pose.time, at)
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):
            animator = Animator.shipped(_one_of(report, number, len(self.takes)))
            edited_motion = edited(animator, clip, request.with_seed(seed))
            finish_takes({name: dress_take(edited_motion, request.apparel, report)}, self.character, workspace, partly)
        return {"takes": list(self.takes)}


def _with_pose(clip: Animation, source: Take, time: float, at: float) -> Animation:
    """The clip with one frame taken from another clip; position and heading are those of the clip."""
    source = handle_animation_of(source)
    frame = min(round(time * clip.fps), len(clip.motion) - 1)
    there = min(round(at * source.fps), len(source.motion) - 1)

    def patched(motion: HandleMotion, other: HandleMotion) -> HandleMotion:
        pose = placed_at(other.take(slice(there, there + 1)), 0, motion, frame)
        arrays = {name: np.array(getattr(motion, name)) for name in HandleMotion.arrays}
        for name, array in arrays.items():
            array[frame] = getattr(pose, name)[0]
        return motion.with_arrays(arrays)

    return Animation(
        clip.character, clip.handles, patched(clip.motion, source.motion),
        patched(reference_of(clip), reference_of(source)),
    )  # fmt: skip


@dataclass(frozen=True)
class Change(DressForm):
    """A take made from another, with nothing generated."""

    character: str
    takes: tuple[str]
    parent: str

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        report("fit", 0.2)
        take = self.changed(workspace.take(self.parent, self.character), workspace, report)
        return finish_takes({self.takes[0]: take}, self.character, workspace, partly)

    def changed(self, parent: Take, workspace: Workspace, report: Progress) -> Take:
        """The new take, by default `moved` and dressed."""
        return dress_take(self.moved(parent), self.apparel_request, report)

    def moved(self, parent: Take) -> Animation | RigAnimation:
        """The motion of the new take."""
        raise NotImplementedError


@dataclass(frozen=True)
class Bend(Change):
    """A take bent to its pins."""

    constraints: tuple[object, ...]

    def moved(self, parent: Take) -> Animation:
        clip = handle_animation_of(parent)
        pins = Constraints.from_json(self.constraints).pins
        met = meet_pins(clip.motion, Anatomy.of(clip.character, clip.handles), pins)
        return Animation(clip.character, clip.handles, met, clip.reference)


@dataclass(frozen=True)
class Mirror(Change):
    """A take with left and right exchanged, fitted anew."""

    def moved(self, parent: Take) -> Animation:
        clip = handle_animation_of(parent)
        anatomy = Anatomy.of(clip.character, clip.handles)
        motion = reference_of(clip, anatomy)
        return apply_motion(decode(mirror(encode(motion)), motion.fps), anatomy)


@dataclass(frozen=True)
class Trim(Change):
    """A stretch of a take, unchanged."""

    trim: tuple[float, float]

    def moved(self, parent: Take) -> Animation | RigAnimation:
        body = body_of(parent)
        start, stop = (round(second * body.fps) for second in self.trim)
        if stop - start < 2 or start >= len(body.motion):
            raise OptionError("nothing is left of the take; choose a longer stretch of it")
        return body.take(slice(start, stop))


@dataclass(frozen=True)
class Dress(Change):
    """A take of the same motion whose apparel moves otherwise."""

    in_place: bool = False
    without: tuple[str, ...] = ()

    def changed(self, parent: Take, workspace: Workspace, report: Progress) -> Take:
        return redress_take(
            parent, self.apparel_request, workspace.character(self.character)[1], in_place=self.in_place,
            stages=GENERATED_STAGES.without(self.without), report=report,
        )  # fmt: skip


@dataclass(frozen=True)
class Transfer(DressForm):
    """A take from a motion of a file."""

    character: str
    takes: tuple[str]
    file: str
    onto: Literal["auto", "handles"] = "handles"

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        (name,) = self.takes
        character, handles = workspace.character(self.character)
        source = Source(workspace.folder_of("takes", name) / self.file)
        apparel, animator = self.apparel_request, Animator.shipped(report)
        check_fits(apparel, character, 0)
        take = None
        if apparel.moves or self.onto == "auto":
            simulated = apparel if apparel.motion == "simulate" else Apparel()
            take = transferred(animator, character, source, TransferRequest(apparel=simulated))
        if not isinstance(take, RigAnimation):  # on the handles that the studio shows
            take = transferred(animator, character, source, TransferRequest("handles", handles=handles))
        assert isinstance(take, Animation | RigAnimation)
        apparel = Apparel() if apparel.motion == "simulate" else apparel  # simulated already
        return finish_takes({name: dress_take(take, apparel, report)}, self.character, workspace, partly)


PREVIEW_FPS = 10.0
BLEND = 8
"""Frames over which one part goes over into the next."""


@dataclass(frozen=True)
class Piece:
    """A part of a take with its length [s]: a clip of the library by its name, or the JSON form of a request."""

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

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        body = workspace.body(self.character)
        character, handles, anatomy = body.character, body.anatomy.handles, body.anatomy
        apparel, constraints = self.apparel_request, Constraints.from_json(self.constraints)
        check_fits(apparel, character, sum(piece.seconds for piece in self.pieces))
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):
            ahead = _one_of(report, number, len(self.takes))
            animator = Animator(Known(handles=handles), progress=ahead)
            motion = self._reference(animator, body, seed, constraints.loop)
            if apparel.motion == "simulate":
                take: Any = transferred(animator, character, motion, TransferRequest(apparel=apparel))
            else:
                take = dress_take(apply_motion(motion, anatomy, constraints, TRANSFER_STAGES), apparel, ahead)
            finish_takes({name: take}, self.character, workspace, partly)
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
                (moved,) = animator.moved(body, [request])
                assert isinstance(moved, Animation)  # its handles are given
                own = encode(reference_of(moved, anatomy))
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

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        anatomy = workspace.body(self.character).anatomy
        folder = workspace.folder_of("characters", self.character) / PREVIEWS
        for number, name in enumerate(self.clips):
            report("fit", number / len(self.clips))
            path = folder / f"{name}.bin"
            if path.is_file():
                continue
            clip = find_clip(name)
            motion = decode(features_of(clip.stretch, clip.seconds if clip.loops else None, clip.loops))
            fitted = apply_motion(motion, anatomy, Constraints.of(loop=clip.loops), DRAFT_STAGES)
            folder.mkdir(exist_ok=True)
            with atomic_write(path) as file:
                file.write(packed_clip(replace(fitted, motion=resample(fitted.motion, PREVIEW_FPS))))
        return {"clips": list(self.clips)}
