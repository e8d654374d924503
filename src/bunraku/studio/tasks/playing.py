"""Clips of the library: takes that play them among sentences, and how they look on a character."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.clips import clip as find_clip
from bunraku.clips.motions import features_of
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.core.resample import resample
from bunraku.diffusion.features import decode, encode
from bunraku.diffusion.splicing import splice
from bunraku.formats.files import atomic_write
from bunraku.pipelines.animator import Animator, Body
from bunraku.pipelines.apply import apply_motion, reference_of
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request
from bunraku.pipelines.requests.transfer import TransferRequest
from bunraku.pipelines.transfer import TRANSFER_STAGES, transferred
from bunraku.studio.forms.drawing import DressForm
from bunraku.studio.tasks.making import DRAFT_STAGES, Known
from bunraku.studio.tasks.task import Partly, Report, put_away
from bunraku.studio.workspace.clips import packed_clip
from bunraku.studio.workspace.dressing import check_fits, put_on
from bunraku.studio.workspace.workspace import PREVIEWS, Workspace

__all__ = ["Play", "Preview"]

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

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
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
                take = put_on(apply_motion(motion, anatomy, constraints, TRANSFER_STAGES), apparel, ahead)
            put_away(take, name, self.character, shop, partly)
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

    def __call__(self, shop: Workspace, report: Report, partly: Partly) -> dict[str, Any]:
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
