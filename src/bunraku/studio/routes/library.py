"""The clip library: what is found in it, and how clips look on a character."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.clips import Clip, search
from bunraku.clips import clip as find_clip
from bunraku.core.request.json_form import from_json
from bunraku.errors import OptionError
from bunraku.studio.routes.asked import body_of, ready_character, state_of
from bunraku.studio.workspace.workspace import PREVIEWS

__all__ = ["ROUTES"]

MOST_TEXT = 1000
MOST_PREVIEWS = 48
"""Clips of one request."""


def facts_of(clip: Clip) -> dict[str, Any]:
    """A clip as a page gets it."""
    return {
        "name": clip.name, "sentence": clip.sentence, "seconds": clip.seconds, "loops": clip.loops,
        "tags": clip.tags, "credit": clip.source.credit, "terms": clip.source.terms,
    }  # fmt: skip


async def clips(request: Request) -> Any:
    """Clips by words, `?q=`, and tags, `?tag=`; all without."""
    words = request.query_params.get("q", "")
    if len(words) > MOST_TEXT:
        raise OptionError(f"q has more than {MOST_TEXT} characters; look for fewer words")
    tags = request.query_params.getlist("tag")
    return {"clips": [facts_of(clip) for clip in await run_in_threadpool(search, words, tags)]}


@dataclass(frozen=True)
class _PreviewForm:
    """Clips that are to be seen on a character."""

    clips: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= len(self.clips) <= MOST_PREVIEWS:
            raise OptionError(f"1 to {MOST_PREVIEWS} clips are shown at once")
        for name in self.clips:
            find_clip(name)


async def previews(request: Request) -> Any:
    """Make how clips look on a character; the job is null where all are there."""
    state, owner = state_of(request), request.path_params["name"]
    ready_character(state, owner)
    form = from_json(_PreviewForm, await body_of(request), "the request")
    folder = state.store.folder_of("characters", owner) / PREVIEWS
    missing = [name for name in dict.fromkeys(form.clips) if not (folder / f"{name}.bin").is_file()]
    if not missing:
        return {"job": None}
    params = {"character": owner, "clips": missing}
    job = state.jobs.submit("preview", "show clips", params, {"character": owner}, passing=True, first=True)
    return JSONResponse({"job": job["id"]}, 202)


async def preview(request: Request) -> Response:
    """How a clip looks on a character: what its joints do (`clips.packed_clip`)."""
    state, owner = state_of(request), request.path_params["name"]
    file = f"{PREVIEWS}/{find_clip(request.path_params['clip']).name}.bin"
    return FileResponse(state.store.file("characters", owner, file), media_type="application/octet-stream")


ROUTES = [
    ("/clips", ("GET",), clips),
    ("/characters/{name}/clips", ("POST",), previews),
    ("/characters/{name}/clips/{clip}", ("GET",), preview),
]
