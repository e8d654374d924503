"""What the worker does: open a character, make takes, change them, carry a motion over, write files.

A task is a dataclass with a JSON form, which the server checks before it queues it; it reads and writes the binary
files of the store's folders, and records are the server's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.request.json_form import from_json
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.handles.predict import Predictor
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints, Follow
from bunraku.pipelines.requests.request import Request
from bunraku.retarget.fit import Stages
from bunraku.studio.clips import Dressed, Take, body_of, save_handles
from bunraku.studio.dressing import check_fits, dressed_anew, put_on
from bunraku.studio.forms import stages_without
from bunraku.studio.opened import Settings, opened_character, told
from bunraku.studio.workspace import Workspace

__all__ = ["TASKS", "run_task"]

Report = Callable[[str, float], None]
Partly = Callable[[dict[str, Any]], None]
FPS = 20.0
"""What the network knows; takes of other rates, carried over from files, are resampled before they are changed."""
BODIES = (".bvh", ".vrma", ".vmd", ".npz")
"""Formats of the motion of a body, in which apparel has no place."""
DRAFT_STEPS = 3
DRAFT_STAGES = Stages(smooth=False, feet=False, floor=False)
"""Of a draft, which is there to be seen at once."""


class Task(Protocol):
    """Something that the worker does."""

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        """Do it; give what its record learns."""


@dataclass(frozen=True)
class Open:
    """Open a character."""

    character: str
    file: str
    settings: Settings = field(default_factory=Settings)

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io import save_character
        from bunraku.pipelines.animate import rig

        folder = shop.folder_of("characters", self.character)
        report("read", 0.1)
        character, taken = opened_character(folder / self.file, self.settings)
        report("handles", 0.3)
        handles = rig(character, handles=self.settings.handles)
        report("write", 0.8)
        save_character(character, folder / "mesh.glb", handles)
        (folder / "bones.glb").unlink(missing_ok=True)
        save_handles(handles, folder / "handles.npz")
        return {**taken, **told(character, handles), "clips": _clips_of(character)}


def _clips_of(character: Character) -> list[str]:
    """Names of the clips that the character's file brings."""
    from bunraku.formats.gltf.read import Source
    from bunraku.io.play import clip_names

    source = character.source
    return clip_names(source.document)[:50] if isinstance(source, Source) and character.rig is not None else []


@dataclass(frozen=True)
class _Known(Predictor):
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

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator, own_rig

        character, handles = shop.character(self.character)
        request = _followed(shop, Request.from_json(self.request), self.character)
        check_fits(request.apparel, character, request.sampling.seconds)
        if own_rig(character, request) is None:
            request = replace(request, handles=handles)

        def quickly(stage: str, done: float) -> None:
            report("draft", 0.02 + 0.04 * done)

        if self.draft:
            report("draft", 0.02)
            sampling = replace(request.sampling, seed=self.seeds[0], steps=DRAFT_STEPS, candidates=1)
            quick = replace(
                request, sampling=sampling, apparel=Apparel(), stages=DRAFT_STAGES, handles=handles, rig="handles"
            )  # fmt: skip
            (body,) = Animator(_Known(handles=handles), progress=quickly).moved(character, [quick])
            partly({"take": self.takes[0], **shop.keep(body, self.takes[0], self.character, draft=True)})
        ranges = {"generate": (0.1, 0.6), "fit": (0.7, 0.1)}

        def whole(stage: str, done: float) -> None:
            start, share = ranges.get(stage, (0.8, 0.2))
            report(stage, start + share * done)

        requests = [request.with_seed(seed) for seed in self.seeds]
        bodies = Animator(_Known(handles=handles), progress=whole).moved(character, requests)
        for name, body in zip(self.takes, bodies, strict=True):
            take = put_on(body, request.apparel, whole)
            partly({"take": name, "state": "done", **shop.keep(take, name, self.character)})
        return {"takes": list(self.takes)}


def _followed(shop: Workspace, request: Request, owner: str) -> Request:
    """The request with the take opened that it follows."""
    for one in request.constraints:
        if isinstance(one, Follow) and isinstance(one.clip, str):
            before = body_of(shop.take(one.clip, owner))
            return replace(request, constraints=request.constraints.following(before))
    return request


def _of_handles(take: Take) -> Animation:
    body = body_of(take)
    if not isinstance(body, Animation):
        raise OptionError("this take moves the bones of the file; make one that moves handles to change it")
    return body


@dataclass(frozen=True)
class Edit:
    """A take with parts of another kept, for each seed."""

    character: str
    takes: tuple[str, ...]
    seeds: tuple[int, ...]
    parent: str
    request: object

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.apply import GENERATED_STAGES
        from bunraku.pipelines.edit import edited

        request = Request.from_json(self.request)
        request = replace(request, stages=request.stages or GENERATED_STAGES)
        clip = _of_handles(shop.take(self.parent, self.character)).at(FPS)
        for pose in request.constraints.poses:
            at = pose.time if pose.at is None else pose.at
            if pose.take and (pose.take != self.parent or at != pose.time):
                clip = _with_pose(clip, shop.take(pose.take, self.character), pose.time, at)
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):

            def ahead(stage: str, done: float, number: int = number) -> None:
                report(stage, (number + 0.9 * done) / len(self.takes))

            made = edited(Animator.shipped(ahead), clip, request.with_seed(seed))
            take = put_on(made, request.apparel, report)
            partly({"take": name, "state": "done", **shop.keep(take, name, self.character)})
        return {"takes": list(self.takes)}


def _with_pose(clip: Animation, source: Take, time: float, at: float) -> Animation:
    """The clip with one frame taken from another at that one's place in it, heading and way of the clip kept."""
    from bunraku.core.travel import placed_at
    from bunraku.pipelines.apply import reference_of

    source = _of_handles(source)
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
class Bend:
    """A take bent to its pins, with nothing generated."""

    character: str
    takes: tuple[str]
    parent: str
    constraints: tuple[object, ...]
    apparel: str = "rigid"
    stiffness: float = 1.0

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.retarget.stages.pins import meet_pins

        parent = _of_handles(shop.take(self.parent, self.character))
        report("fit", 0.2)
        pins = Constraints.from_json(self.constraints).pins
        met = meet_pins(parent.motion, Anatomy.of(parent.character, parent.handles), pins)
        made = Animation(parent.character, parent.handles, met, parent.reference)
        take, (name,) = put_on(made, Apparel(self.apparel, self.stiffness), report), self.takes
        partly({"take": name, "state": "done", **shop.keep(take, name, self.character)})
        return {"takes": [name]}


@dataclass(frozen=True)
class Dress:
    """A take of the same motion whose apparel moves otherwise."""

    character: str
    takes: tuple[str]
    parent: str
    apparel: str = "rigid"
    stiffness: float = 1.0
    in_place: bool = False
    without: tuple[str, ...] = ()

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        parent, (_, handles) = shop.take(self.parent, self.character), shop.character(self.character)
        made = dressed_anew(
            parent, Apparel(self.apparel, self.stiffness), handles, in_place=self.in_place,
            stages=stages_without(self.without), report=report,
        )  # fmt: skip
        (name,) = self.takes
        partly({"take": name, "state": "done", **shop.keep(made, name, self.character)})
        return {"takes": [name]}


@dataclass(frozen=True)
class Transfer:
    """A take from a motion of a file."""

    character: str
    takes: tuple[str]
    file: str
    apparel: str = "rigid"
    stiffness: float = 1.0
    onto: Literal["auto", "handles"] = "handles"

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.requests.transfer import TransferRequest
        from bunraku.pipelines.transfer import Source, transferred

        (name,) = self.takes
        character, handles = shop.character(self.character)
        source = Source(shop.folder_of("takes", name) / self.file)
        apparel, animator = Apparel(self.apparel, self.stiffness), Animator.shipped(report)
        check_fits(apparel, character, 0)
        take = None
        if apparel.moves or self.onto == "auto":
            own = apparel if apparel.motion == "simulate" else Apparel()
            take = transferred(animator, character, source, TransferRequest(apparel=own))
        if not isinstance(take, RigAnimation):  # on the handles that the studio shows
            take = transferred(animator, character, source, TransferRequest("handles", handles=handles))
        assert isinstance(take, Animation | RigAnimation)
        apparel = Apparel() if apparel.motion == "simulate" else apparel  # simulated already
        partly({"take": name, "state": "done", **shop.keep(put_on(take, apparel, report), name, self.character)})
        return {"takes": [name]}


@dataclass(frozen=True)
class Export:
    """A take as a file of another program."""

    character: str
    export: str
    file: str
    take: str
    fps: float = 30.0

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io.registry import check_writer

        target = shop.folder_of("exports", self.export) / self.file
        check_writer(target)
        report("write", 0.1)
        take = shop.take(self.take, self.character)
        options = {} if target.suffix in (".npz", ".vmd") else {"fps": self.fps}
        if isinstance(take, Dressed):
            (take.body if target.suffix in BODIES else take.points).save(target, **options)
        else:
            take.save(target, **options)
        return {"export": self.export, "bytes": target.stat().st_size}


@dataclass(frozen=True)
class ExportClips:
    """Several takes of a character as the clips of one GLB."""

    character: str
    export: str
    file: str
    takes: tuple[str, ...]
    names: tuple[str, ...]
    fps: float = 30.0

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.io.save_clips import save_clips

        target, clips = shop.folder_of("exports", self.export) / self.file, {}
        character: Character | None = None
        for number, (take, name) in enumerate(zip(self.takes, self.names, strict=True)):
            report("read", number / len(self.takes))
            found = shop.take(take, self.character)
            if isinstance(found, Dressed):
                raise OptionError(
                    "apparel that moves on its own has no place among several clips; download those alone"
                )
            character = character or found.character
            clips[name] = replace(found, character=character)  # each was read with a copy of it
        save_clips(clips, target, fps=self.fps)
        return {"export": self.export, "bytes": target.stat().st_size}


TASKS: dict[str, type[Task]] = {
    "open": Open,
    "animate": Animate,
    "edit": Edit,
    "bend": Bend,
    "dress": Dress,
    "transfer": Transfer,
    "export": Export,
    "export-clips": ExportClips,
}


def run_task(shop: Workspace, task: str, params: object, report: Report, partly: Partly) -> dict[str, Any]:
    """Run a task of `TASKS`.

    Args:
        shop: What it works with.
        task: Its name.
        params: Its JSON form.
        report: Called with a stage's name and the share done.
        partly: Called with what is there before the end.

    Raises:
        OptionError: There is no such task, or it cannot be done.
    """
    if task not in TASKS:
        raise OptionError(f"there is no task '{task}'")
    return from_json(TASKS[task], params, f"the task {task}")(shop, report, partly)
