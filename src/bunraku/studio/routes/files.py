"""Projects: how the page stood, and a project as one file."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.errors import OptionError
from bunraku.studio.projects import pack_project, unpack_project
from bunraku.studio.routes.asked import body_of, state_of
from bunraku.studio.uploads import plain_name, receive

__all__ = ["ROUTES"]

MOST_PROJECTS = 200


async def projects(request: Request) -> Any:
    """All projects; POST adds one: what it says is the page's own affair."""
    state = state_of(request)
    if request.method == "GET":
        return {"projects": state.store.all("projects")}
    if len(state.store.all("projects")) >= MOST_PROJECTS:
        raise OptionError(f"there are {MOST_PROJECTS} projects; delete some that are not needed")
    body = await body_of(request)
    return JSONResponse(state.store.new("projects", {"view": body.get("view") or {}}), 201)


async def project(request: Request) -> Any:
    """One project; PUT keeps how the page stands."""
    state, name = state_of(request), request.path_params["name"]
    if request.method == "PUT":
        body = await body_of(request)
        return state.store.change("projects", name, view=body.get("view") or {})
    if request.method == "DELETE":
        state.store.get("projects", name)
        state.store.drop("projects", name)
        return {}
    return state.store.get("projects", name)


async def packed(request: Request) -> Response:
    """A character with its takes as one file; the body says how the page stood."""
    state, name = state_of(request), request.path_params["name"]
    view = (await body_of(request)).get("view")
    title = state.store.get("characters", name)["name"]
    made = state.store.new("exports", {"file": "project.bunraku", "title": f"{title}.bunraku"})
    path = state.store.place("exports", made["id"]) / made["file"]
    try:
        await run_in_threadpool(pack_project, state.store, name, view if isinstance(view, dict) else {}, path)
    except BaseException:
        state.store.drop("exports", made["id"])
        raise
    return FileResponse(path, filename=made["title"], media_type="application/zip")


async def opened(request: Request) -> Any:
    """Open the project file in the body."""
    state = state_of(request)
    title, _ = plain_name(request.query_params.get("name", ""))
    made = state.store.new("exports", {"file": "project.bunraku", "title": title})
    path = state.store.place("exports", made["id"]) / f"{title}.bunraku"
    try:
        await receive(request, path)
        found = await run_in_threadpool(unpack_project, state.store, path)
    finally:
        state.store.drop("exports", made["id"])
    state.jobs.tell("character", state.store.get("characters", found["character"]))
    for name in found["takes"].values():
        state.jobs.tell("take", state.store.get("takes", name))
    return JSONResponse(found, 201)


ROUTES = [
    ("/projects", ("GET", "POST"), projects),
    ("/projects/{name}", ("GET", "PUT", "DELETE"), project),
    ("/characters/{name}/project", ("POST",), packed),
    ("/project-files", ("POST",), opened),
]
