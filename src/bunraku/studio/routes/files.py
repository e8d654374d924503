"""Projects: how the page stood, and a project as one file."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.errors import BunrakuError
from bunraku.studio.projects import pack_project, unpack_project
from bunraku.studio.records import Record
from bunraku.studio.routes.asked import beside, state_of
from bunraku.studio.uploads import plain_name, receive
from bunraku.studio.view import checked_view, read_view

__all__ = ["ROUTES", "Newer", "shown_project"]

MOST_PROJECTS = 200
"""Each tab has one."""


class Newer(BunrakuError):
    """Another page keeps how it stands in the same project."""


def shown_project(record: Record) -> Record:
    """A project as a page gets it: how a page stood, put right where an earlier one kept what cannot be."""
    return {**record, "view": read_view(record["view"])}


@beside
def projects(request: Request, body: dict[str, Any]) -> Any:
    """All projects; POST adds one for a tab; where there are many, that which was kept longest ago goes."""
    state = state_of(request)
    if request.method == "GET":
        return {"projects": [shown_project(record) for record in state.store.all("projects")]}
    view = checked_view(body.get("view"))
    kept = sorted(state.store.all("projects"), key=lambda record: float(record.get("saved", 0)))
    for old in kept[: max(0, len(kept) + 1 - MOST_PROJECTS)]:
        state.store.drop("projects", old["id"])
    return JSONResponse(state.store.new("projects", {"view": view, "saved": time.time(), "revision": 0}), 201)


@beside
def project(request: Request, body: dict[str, Any]) -> Any:
    """One project; PUT keeps how the page stands. A page that says which revision it knows is refused where another one
    was faster.
    """
    state, name = state_of(request), request.path_params["name"]
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


@beside
def packed(request: Request, body: dict[str, Any]) -> Response:
    """A character with its takes as one file; the body says how the page stood."""
    state, name = state_of(request), request.path_params["name"]
    view = checked_view(body.get("view"))
    title = state.store.get("characters", name)["name"]
    made = state.new_export("project.bunraku", f"{title}.bunraku")
    path = state.store.folder_of("exports", made["id"]) / made["file"]
    try:
        pack_project(state.store, name, view, path)
    except BaseException:
        state.store.drop("exports", made["id"])
        raise
    state.store.note("exports", made["id"], state="done")
    return FileResponse(path, filename=made["title"], media_type="application/zip")


async def opened(request: Request) -> Any:
    """Open the project file in the body."""
    state = state_of(request)
    title, _ = plain_name(request.query_params.get("name", ""))
    made = await run_in_threadpool(state.new_export, "project.bunraku", title)
    path = state.store.folder_of("exports", made["id"]) / f"{title}.bunraku"
    try:
        await receive(request, path)
        found = await run_in_threadpool(unpack_project, state.store, path)
    finally:
        await run_in_threadpool(state.store.drop, "exports", made["id"])
    record = state.store.get("characters", found["character"])
    state.jobs.changes.tell("character", record)
    if "ends" not in record:  # it was saved before they were found
        with suppress(BunrakuError):
            state.find_out(record["id"])
    for name in found["takes"].values():
        state.jobs.changes.tell("take", state.store.get("takes", name))
    return JSONResponse(found, 201)


ROUTES = [
    ("/projects", ("GET", "POST"), projects),
    ("/projects/{name}", ("GET", "PUT", "DELETE"), project),
    ("/characters/{name}/project", ("POST",), packed),
    ("/project-files", ("POST",), opened),
]
