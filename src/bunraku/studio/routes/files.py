"""Projects: how the page stood, and a project as one file."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.errors import OptionError
from bunraku.studio.projects import pack_project, unpack_project
from bunraku.studio.routes.asked import body_of, desk_of
from bunraku.studio.uploads import plain_name, receive

__all__ = ["ROUTES"]

MOST_PROJECTS = 200


async def projects(request: Request) -> Any:
    """All projects; POST adds one: what it says is the page's own affair."""
    desk = desk_of(request)
    if request.method == "GET":
        return {"projects": desk.store.all("projects")}
    if len(desk.store.all("projects")) >= MOST_PROJECTS:
        raise OptionError(f"there are {MOST_PROJECTS} projects; delete some that are not needed")
    body = await body_of(request)
    return JSONResponse(desk.store.new("projects", {"view": body.get("view") or {}}), 201)


async def project(request: Request) -> Any:
    """One project; PUT keeps how the page stands."""
    desk, name = desk_of(request), request.path_params["name"]
    if request.method == "PUT":
        body = await body_of(request)
        return desk.store.change("projects", name, view=body.get("view") or {})
    if request.method == "DELETE":
        desk.store.get("projects", name)
        desk.store.drop("projects", name)
        return {}
    return desk.store.get("projects", name)


async def packed(request: Request) -> Response:
    """A character with its takes as one file; the body says how the page stood."""
    desk, name = desk_of(request), request.path_params["name"]
    view = (await body_of(request)).get("view")
    title = desk.store.get("characters", name)["name"]
    made = desk.store.new("exports", {"file": "project.bunraku", "title": f"{title}.bunraku"})
    path = desk.store.place("exports", made["id"]) / made["file"]
    try:
        await run_in_threadpool(pack_project, desk.store, name, view if isinstance(view, dict) else {}, path)
    except BaseException:
        desk.store.drop("exports", made["id"])
        raise
    return FileResponse(path, filename=made["title"], media_type="application/zip")


async def opened(request: Request) -> Any:
    """Open the project file in the body."""
    desk = desk_of(request)
    title, _ = plain_name(request.query_params.get("name", ""))
    made = desk.store.new("exports", {"file": "project.bunraku", "title": title})
    path = desk.store.place("exports", made["id"]) / f"{title}.bunraku"
    try:
        await receive(request, path)
        found = await run_in_threadpool(unpack_project, desk.store, path)
    finally:
        desk.store.drop("exports", made["id"])
    desk.jobs.tell("character", desk.store.get("characters", found["character"]))
    for name in found["takes"].values():
        desk.jobs.tell("take", desk.store.get("takes", name))
    return JSONResponse(found, 201)


ROUTES = [
    ("/projects", ("GET", "POST"), projects),
    ("/projects/{name}", ("GET", "PUT", "DELETE"), project),
    ("/characters/{name}/project", ("POST",), packed),
    ("/project-files", ("POST",), opened),
]
