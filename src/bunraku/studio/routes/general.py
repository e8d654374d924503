"""Routes about the studio itself, its jobs, projects, and the clip library."""

from __future__ import annotations

import hmac
import importlib.util
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.core.request import FPS, Length, from_json
from bunraku.errors import BunrakuError, OptionError
from bunraku.files import preset_rows
from bunraku.generation.library import clip as find_clip
from bunraku.generation.library import search
from bunraku.studio.jobs import public
from bunraku.studio.projects import pack_project, unpack_project
from bunraku.studio.records import Record, checked_view, read_view
from bunraku.studio.routes import reading
from bunraku.studio.workspace import PREVIEWS

MOST_PROJECTS = 200
"""Each tab has one."""


class Newer(BunrakuError):
    """Another page keeps its view in the same project."""


def shown_project(record: Record) -> Record:
    """A project as a page gets it, its view repaired where it holds what cannot be shown."""
    return {**record, "view": read_view(record["view"])}


@reading.beside()
def projects(request: Request, body: dict[str, Any]) -> Any:
    """All projects; POST adds one for a tab, and drops the oldest where there are too many."""
    state = reading.studio_state(request)
    if request.method == "GET":
        return {"projects": [shown_project(record) for record in state.store.all("projects")]}
    view = checked_view(body.get("view"))
    kept = sorted(state.store.all("projects"), key=lambda record: float(record.get("saved", 0)))
    for old in kept[: max(0, len(kept) + 1 - MOST_PROJECTS)]:
        state.store.drop("projects", old["id"])
    return JSONResponse(state.store.new("projects", {"view": view, "saved": time.time(), "revision": 0}), 201)


@reading.beside()
def project(request: Request, body: dict[str, Any]) -> Any:
    """One project; PUT keeps the view of a page. A page that names an older revision is refused."""
    state, name = reading.studio_state(request), request.path_params["name"]
    if request.method == "PUT":
        view = checked_view(body.get("view"))
        record = state.store.get("projects", name)
        revision = record.get("revision", 0)
        if body.get("revision", revision) != revision:
            raise Newer("another tab keeps its view here; this one gets a project of its own")
        return state.store.change("projects", name, view=view, saved=time.time(), revision=revision + 1)
    if request.method == "DELETE":
        state.store.get("projects", name)
        state.store.drop("projects", name)
        return {}
    return shown_project(state.store.get("projects", name))


@reading.beside()
def packed(request: Request, body: dict[str, Any]) -> Response:
    """A character with its takes as one file; the body has the view of the page."""
    state, name = reading.studio_state(request), request.path_params["name"]
    view = checked_view(body.get("view"))
    title = state.store.get("characters", name)["name"]
    export = state.new_export("project.bunraku", f"{title}.bunraku")
    path = state.store.folder_of("exports", export["id"]) / export["file"]
    try:
        pack_project(state.store, name, view, path)
    except BaseException:
        state.store.drop("exports", export["id"])
        raise
    state.store.note("exports", export["id"], state="done")
    return FileResponse(path, filename=export["title"], media_type="application/zip")


async def opened(request: Request) -> Any:
    """Open the project file in the body."""
    state = reading.studio_state(request)
    title, _ = reading.plain_name(request.query_params.get("name", ""))
    export = await run_in_threadpool(state.new_export, "project.bunraku", title)
    path = state.store.folder_of("exports", export["id"]) / f"{title}.bunraku"
    try:
        await reading.receive(request, path)
        project = await run_in_threadpool(unpack_project, state.store, path)
    finally:
        await run_in_threadpool(state.store.drop, "exports", export["id"])
    record = state.store.get("characters", project["character"])
    state.jobs.changes.tell("character", record)
    if "ends" not in record:  # it was saved before they were found
        with suppress(BunrakuError):
            state.find_out(record["id"])
    for name in project["takes"].values():
        state.jobs.changes.tell("take", state.store.get("takes", name))
    return JSONResponse(project, 201)


MOST_TEXT = 1000
MOST_PREVIEWS = 48
"""Clips of one request."""


async def clips(request: Request) -> Any:
    """Clips by words, `?q=`, and tags, `?tag=`; all without."""
    words = request.query_params.get("q", "")
    Length(MOST_TEXT).check(words, "q")
    tags = request.query_params.getlist("tag")
    return {"clips": [clip.facts for clip in await run_in_threadpool(search, words, tags)]}


@dataclass(frozen=True)
class _PreviewForm:
    """Clips that are to be seen on a character."""

    clips: Annotated[tuple[str, ...], Length(MOST_PREVIEWS, 1)]

    def __post_init__(self) -> None:
        for name in self.clips:
            find_clip(name)


@reading.beside(_PreviewForm, alone=False)
def previews(request: Request, form: _PreviewForm) -> Any:
    """Show clips on a character; the job is null where all are there."""
    state, owner = reading.studio_state(request), request.path_params["name"]
    reading.ready_character(state, owner)
    folder = state.store.folder_of("characters", owner) / PREVIEWS
    missing = [name for name in dict.fromkeys(form.clips) if not (folder / f"{name}.bin").is_file()]
    if not missing:
        return {"job": None}
    params = {"character": owner, "clips": missing}
    job = state.jobs.submit("preview", "show clips", params, {"character": owner}, passing=True, first=True)
    return JSONResponse({"job": job["id"]}, 202)


async def preview(request: Request) -> Response:
    """How a clip looks on a character: what its joints do (`clips.packed_clip`)."""
    state, owner = reading.studio_state(request), request.path_params["name"]
    file = f"{PREVIEWS}/{find_clip(request.path_params['clip']).name}.bin"
    return FileResponse(state.store.file("characters", owner, file), media_type="application/octet-stream")


SUGGESTED = 6
"""Clips of the library that a sentence suggests."""
LONGEST_NUMBER = 15
"""Digits of a number in an address."""


async def about(request: Request) -> Any:
    """What this installation can do, and all that there is."""
    from bunraku import __version__
    from bunraku.files import sample_names

    state = reading.studio_state(request)
    more = [("pxr", ("usdz",)), ("av", ("mp4",)), ("PIL", ("gif",))]
    found = [name for module, names in more if importlib.util.find_spec(module) is not None for name in names]
    return {
        "version": __version__, "limits": {"bytes": reading.MOST_BYTES, "seconds": 120, "takes": 8},
        "reads": {"characters": reading.CHARACTERS, "motions": reading.MOTIONS, "projects": reading.PROJECTS},
        "writes": ["glb", "fbx", "bvh", "vrma", "vmd", "npz", *found], "fps": [FPS.low, FPS.high],
        "presets": preset_rows(), "samples": list(sample_names()), "folder": state.store.folder.name,
        "worker": {"warm": state.jobs.warm, "process": state.jobs.process_id}, "event": state.jobs.changes.last,
        "trouble": state.store.trouble, "set_aside": state.store.set_aside,
        "characters": state.store.all("characters"), "takes": state.store.all("takes"),
        "projects": [shown_project(record) for record in state.store.all("projects")],
        "jobs": [public(job) for job in state.jobs.all() if job["state"] in ("waiting", "running", "interrupted")],
    }  # fmt: skip


MOST_LOGIN = 4096
"""Bytes of a request to log in, which anybody may send."""
MOST_CLIENTS = 1000
"""Addresses whose wrong passwords are counted."""
LONGEST_WAIT = 60
"""Seconds between two passwords from one address, after some wrong ones; the first wait is a second."""


@dataclass(frozen=True)
class _LoginForm:
    password: str = ""


async def login(request: Request) -> Any:
    """The token, in exchange for the password."""
    keys, tries, now = request.app.state.keys, request.app.state.tries, time.monotonic()
    given = from_json(_LoginForm, await reading.body_of(request, MOST_LOGIN), "the request").password
    client = request.client.host if request.client else ""
    count, free = tries.pop(client, (0, 0.0))
    if now < free:
        tries[client] = count, free
        left = f"that was tried {count} times; wait {free - now:.0f} seconds, then type the password again"
        return JSONResponse({"error": left, "kind": "Refused"}, 429)
    if keys.password and hmac.compare_digest(given.encode(), keys.password.encode()):
        return {"token": keys.token}
    tries[client] = count + 1, now + min(2.0**count, LONGEST_WAIT)
    if len(tries) > MOST_CLIENTS:
        tries.pop(next(iter(tries)))
    return JSONResponse({"error": "this is not the password", "kind": "Refused"}, 401)


@dataclass(frozen=True)
class _TextForm:
    text: Annotated[str, Length(MOST_TEXT)] = ""


@reading.beside(_TextForm, alone=False)
def understand(request: Request, form: _TextForm) -> Any:
    """What is understood of a sentence, with the positions of unknown words."""
    from bunraku.language.parse import parse
    from bunraku.language.understood import understood

    words, seconds = understood(form.text), None
    with suppress(BunrakuError):
        seconds = parse(form.text).seconds  # what the network reads is remembered, so Enter need not wait for it
    return {
        "clips": [clip.name for clip in search(form.text)[:SUGGESTED]], "ok": words.ok, "language": words.language,
        "english": words.english,
        "unknown": [{"word": word.word, "start": word.start, "stop": word.stop} for word in words.unknown],
        "corrected": [list(pair) for pair in words.corrected], "nearest": list(words.nearest),
        "notes": list(words.notes), "seconds": seconds,
    }  # fmt: skip


async def changes(request: Request) -> Any:
    """What has changed after the number `?after=`; without it, the number to ask with."""
    changes = reading.studio_state(request).jobs.changes
    given = request.query_params.get("after", str(changes.last))
    if not given.isascii() or not given.isdecimal() or len(given) > LONGEST_NUMBER:
        raise OptionError("after must be a whole number; reload the page")
    return changes.since(int(given))


async def jobs(request: Request) -> Any:
    """All jobs that are known."""
    return {"jobs": [public(job) for job in reading.studio_state(request).jobs.all()]}


async def job(request: Request) -> Any:
    """One job; DELETE cancels it."""
    state, name = reading.studio_state(request), request.path_params["name"]
    if request.method == "DELETE":
        return public(await run_in_threadpool(state.jobs.cancel, name))
    return public(state.jobs.get(name))


async def again(request: Request) -> Any:
    """Make what was interrupted or failed again."""
    state = reading.studio_state(request)
    old = state.jobs.get(request.path_params["name"])
    job = await run_in_threadpool(state.jobs.again, old["id"])
    await run_in_threadpool(state.revive, old["about"])
    return public(job)


ROUTES = [
    ("/about", ("GET",), about),
    ("/login", ("POST",), login),
    ("/understand", ("POST",), understand),
    ("/changes", ("GET",), changes),
    ("/jobs", ("GET",), jobs),
    ("/jobs/{name}", ("GET", "DELETE"), job),
    ("/jobs/{name}/again", ("POST",), again),
    ("/projects", ("GET", "POST"), projects),
    ("/projects/{name}", ("GET", "PUT", "DELETE"), project),
    ("/characters/{name}/project", ("POST",), packed),
    ("/project-files", ("POST",), opened),
    ("/clips", ("GET",), clips),
    ("/characters/{name}/clips", ("POST",), previews),
    ("/characters/{name}/clips/{clip}", ("GET",), preview),
]
