"""Takes of sentences: generated, and changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.handles.predict import Predictor
from bunraku.pipelines.animator import Body
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Follow
from bunraku.pipelines.requests.request import Request
from bunraku.retarget.fit import Stages
from bunraku.studio.tasks.task import Partly, Report, of_handles, put_away
from bunraku.studio.workspace.clips import Take, body_of
from bunraku.studio.workspace.dressing import check_fits, put_on
from bunraku.studio.workspace.workspace import Workspace

__all__ = ["DRAFT_STAGES", "Animate", "Edit", "Known"]

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

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
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
            take = put_on(made, request.apparel, whole)
            put_away(take, name, self.character, shop, partly)
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

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.apply import GENERATED_STAGES
        from bunraku.pipelines.edit import edited

        request = Request.from_json(self.request)
        request = replace(request, stages=request.stages or GENERATED_STAGES)
        clip = of_handles(shop.take(self.parent, self.character)).at(FPS)
        for pose in request.constraints.poses:
            at = pose.time if pose.at is None else pose.at
            if pose.take and (pose.take != self.parent or at != pose.time):
                clip = _with_pose(clip, shop.take(pose.take, self.character), pose.time, at)
        for number, (name, seed) in enumerate(zip(self.takes, self.seeds, strict=True)):

            def ahead(stage: str, done: float, number: int = number) -> None:
                report(stage, (number + 0.9 * done) / len(self.takes))

            made = edited(Animator.shipped(ahead), clip, request.with_seed(seed))
            take = put_on(made, request.apparel, report)
            put_away(take, name, self.character, shop, partly)
        return {"takes": list(self.takes)}


def _with_pose(clip: Animation, source: Take, time: float, at: float) -> Animation:
    """The clip with one frame taken from another at that one's place in it, heading and way of the clip kept."""
    from bunraku.core.travel import placed_at
    from bunraku.pipelines.apply import reference_of

    source = of_handles(source)
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
