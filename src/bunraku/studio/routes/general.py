"""About the studio, its jobs, what happens, and what is understood of a sentence."""

from __future__ import annotations

import asyncio
import hmac
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse

from bunraku.core.request.limits import FPS
from bunraku.errors import OptionError
from bunraku.io.presets import preset_rows
from bunraku.studio.jobs import public
from bunraku.studio.routes.asked import body_of, state_of, text
from bunraku.studio.routes.files import shown_project
from bunraku.studio.uploads import CHARACTERS, MOST_BYTES, MOTIONS, PROJECTS

__all__ = ["ROUTES"]

SUGGESTED = 6
"""Clips of the library that a sentence suggests."""
LONGEST_NUMBER = 15
"""Digits of a number in an address."""


async def about(request: Request) -> Any:
    """What this installation can do, and all that there is."""
    from bunraku import __version__
    from bunraku.samples import sample_names

    state = state_of(request)
    return {
        "version": __version__,
        "limits": {"bytes": MOST_BYTES, "seconds": 120, "takes": 8},
        "reads": {"characters": CHARACTERS, "motions": MOTIONS, "projects": PROJECTS},
        "writes": _writes(),
        "fps": [FPS.low, FPS.high],
        "presets": preset_rows(),
        "samples": list(sample_names()),
        "folder": state.store.folder.name,
        "worker": {"warm": state.jobs.warm, "process": state.jobs.process_id},
        "event": state.jobs.changes.last,
        "trouble": state.store.trouble,
        "set_aside": state.store.set_aside,
        "characters": state.store.all("characters"),
        "takes": state.store.all("takes"),
        "projects": [shown_project(record) for record in state.store.all("projects")],
        "jobs": [public(job) for job in state.jobs.all() if job["state"] in ("waiting", "running", "interrupted")],
    }


def _writes() -> list[str]:
    import importlib.util

    found = ["glb", "fbx", "bvh", "vrma", "vmd", "npz"]
    if importlib.util.find_spec("pxr") is not None:
        found.append("usdz")
    return found


async def login(request: Request) -> Any:
    """The token, for who knows the password."""
    keys = request.app.state.keys
    given = text(await body_of(request), "password", 200)
    await asyncio.sleep(1)  # slow enough that nobody tries them all
    if not keys.password or not hmac.compare_digest(given.encode(), keys.password.encode()):
        return JSONResponse({"error": "this is not the password", "kind": "Refused"}, 401)
    return {"token": keys.token}


async def understand(request: Request) -> Any:
    """What is understood of a sentence, with the places of words that are not."""
    from bunraku.clips import search
    from bunraku.language.understood import understood

    words = text(await body_of(request), "text", 1000)
    found = await run_in_threadpool(understood, words)
    clips = await run_in_threadpool(search, words)
    return {
        "clips": [clip.name for clip in clips[:SUGGESTED]],
        "ok": found.ok,
        "language": found.language,
        "english": found.english,
        "unknown": [{"word": one.word, "start": one.start, "stop": one.stop} for one in found.unknown],
        "corrected": [list(pair) for pair in found.corrected],
        "nearest": list(found.nearest),
        "notes": list(found.notes),
    }


async def changes(request: Request) -> Any:
    """What has changed after the number `?after=`; without it, the number to ask with."""
    found = state_of(request).jobs.changes
    given = request.query_params.get("after", str(found.last))
    if not given.isascii() or not given.isdecimal() or len(given) > LONGEST_NUMBER:
        raise OptionError("after must be a whole number; reload the page")
    return found.since(int(given))


async def jobs(request: Request) -> Any:
    """All jobs that are known."""
    return {"jobs": [public(job) for job in state_of(request).jobs.all()]}


async def job(request: Request) -> Any:
    """One job; DELETE cancels it."""
    state, name = state_of(request), request.path_params["name"]
    if request.method == "DELETE":
        return public(await run_in_threadpool(state.jobs.cancel, name))
    return public(state.jobs.get(name))


async def again(request: Request) -> Any:
    """Make what was interrupted or failed again."""
    state = state_of(request)
    old = state.jobs.get(request.path_params["name"])
    made = await run_in_threadpool(state.jobs.again, old["id"])
    await run_in_threadpool(state.revive, old["about"])
    return public(made)


ROUTES = [
    ("/about", ("GET",), about),
    ("/login", ("POST",), login),
    ("/understand", ("POST",), understand),
    ("/changes", ("GET",), changes),
    ("/jobs", ("GET",), jobs),
    ("/jobs/{name}", ("GET", "DELETE"), job),
    ("/jobs/{name}/again", ("POST",), again),
]
