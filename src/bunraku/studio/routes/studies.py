"""The blind study: what a participant sees next, the clips, and the answers."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.core.request.limits import Limit
from bunraku.studio.routes.asked import body_of, number, state_of, text
from bunraku.studio.store import NotThere
from bunraku.studio.study.show import Session

__all__ = ["ROUTES"]


def _session(request: Request) -> Session:
    session = state_of(request).session
    if session is None:
        raise NotThere("no study is shown; start the studio with --study")
    return session


async def next_trial(request: Request) -> Any:
    """What a participant sees next; without `?participant=` a new one begins."""
    return _session(request).next(request.query_params.get("participant", "")[:20])


async def clip(request: Request) -> Response:
    """A clip, which tells nothing of who made it."""
    return FileResponse(_session(request).clip(request.path_params["name"]), media_type="model/gltf-binary")


async def answers(request: Request) -> Any:
    """Take an answer; the next trial comes back."""
    session, body = _session(request), await body_of(request)
    participant = text(body, "participant", 20)
    seconds = number(body, "seconds", Limit("seconds", 0, 1e6), 0)
    await run_in_threadpool(session.answer, participant, text(body, "trial", 40), body.get("ranks"), seconds)
    return JSONResponse(session.next(participant), 201)


ROUTES = [
    ("/study", ("GET",), next_trial),
    ("/study/clips/{name}", ("GET",), clip),
    ("/study/answers", ("POST",), answers),
]
