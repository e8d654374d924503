"""Takes: made from sentences, changed, carried over from motions, shown, written as files."""

from __future__ import annotations

import asyncio
import functools
import secrets
import time
from typing import Any, Literal

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.core.request import from_json, to_json
from bunraku.errors import FormatError, OptionError
from bunraku.files import preset_named
from bunraku.pipelines.requests import Apparel, clip_names
from bunraku.studio.forms import (
    ChangeForm,
    ClipsForm,
    DressForm,
    ExportForm,
    LiveForm,
    PlayedForm,
    TakeForm,
    TakeRecordForm,
    read_script,
    script_json,
    sequence_of,
)
from bunraku.studio.jobs import OPEN_STATES
from bunraku.studio.routes.reading import (
    CHARACTERS,
    MOTIONS,
    beside,
    body_of,
    plain_name,
    ready_character,
    receive,
    studio_state,
)
from bunraku.studio.state import State

PATIENCE = 30
"""Seconds that a live character waits for other jobs."""
MOST_NAME = 40
"""Letters of a sentence in a file's name."""


async def takes(request: Request) -> Any:
    """The takes of a character; POST makes some from a script."""
    state, owner = studio_state(request), request.path_params["name"]
    if request.method == "GET":
        state.store.get("characters", owner)
        return {"takes": [take for take in state.store.all("takes") if take["character"] == owner]}
    body = await body_of(request)
    return JSONResponse(await run_in_threadpool(_make, state, owner, body), 202)


def _make(state: State, owner: str, body: dict[str, object]) -> Any:
    character = ready_character(state, owner)
    form = from_json(TakeForm, body, "the request")
    if any(part.clip for part in form.script):
        return _play(state, owner, form, character["settings"]["handles"])
    request = form.request(character["settings"]["handles"])
    if form.after:
        before = state.store.get("takes", form.after)
        if before["character"] != owner or before["state"] != "done" or before.get("skin") != "handles":
            raise OptionError("what is followed must be a finished take of handles of the same character")
    script = script_json(read_script(form.script))
    takes = state.new_takes(
        owner, len(form.seeds), how="animate", script=script, asked=form.asked(), seeds=list(form.seeds)
    )
    params = {"request": request.to_json(), "seeds": list(form.seeds), "draft": form.draft}
    return {**state.make("animate", request.prompt, owner, _ids(takes), params), "script": script}


def _play(state: State, owner: str, form: TakeForm, handles: Literal["predict", "rig"]) -> Any:
    """Takes of a script in which clips of the library are played."""
    script = read_script(form.script)
    pieces, apparel = form.pieces(handles), form.apparel
    constraints = form.constraints()
    constraints.check()
    takes = state.new_takes(
        owner, len(form.seeds), how="animate", script=script_json(script), asked=form.asked(), seeds=list(form.seeds)
    )
    params = {
        "seeds": list(form.seeds), "pieces": pieces, "constraints": constraints.to_json(), "apparel": apparel,
        "stiffness": form.stiffness, "gravity": form.gravity,
    }  # fmt: skip
    return {**state.make("play", sequence_of(script), owner, _ids(takes), params), "script": script_json(script)}


def _ids(takes: list[dict[str, Any]]) -> list[str]:
    return [take["id"] for take in takes]


def _factor(name: str, word: str | None) -> Any:
    """A number of an address."""
    try:
        return None if word is None else float(word)
    except ValueError:
        raise OptionError(f"{name} must be a number") from None


def _worn(take: dict[str, Any]) -> Apparel:
    """How the apparel of a take moves on its own; what is simulated by the file's physics goes with the body."""
    stiffness = take.get("stiffness")
    if not stiffness:
        return Apparel("rigid")
    gravity = take.get("gravity")
    return Apparel(take.get("worn") or "learn", stiffness, 1.0 if gravity is None else gravity)


@beside
def take(request: Request, body: dict[str, Any]) -> Any:
    """One take; PATCH stars or names it; DELETE gives it up, which PATCH with `deleted` false takes back."""
    state, name = studio_state(request), request.path_params["name"]
    record = state.store.get("takes", name)
    if request.method == "DELETE":
        return state.change("takes", name, deleted=True)
    if request.method == "PATCH":
        from_json(TakeRecordForm, body, "the request")
        values = {name: value for name, value in body.items() if value is not None}
        return state.change("takes", name, **values) if values else record
    return record


async def clip(request: Request) -> Response:
    """What the joints of a take do (`clips.packed_clip`): of its draft while there is no more."""
    state, name = studio_state(request), request.path_params["name"]
    file = "clip.bin" if state.store.get("takes", name)["state"] == "done" else "draft.bin"
    return FileResponse(state.store.file("takes", name, file), media_type="application/octet-stream")


async def change(request: Request) -> Any:
    """New takes from one: parts or poses kept and the rest generated, or bent, mirrored, trimmed, dressed anew."""
    state, name = studio_state(request), request.path_params["name"]
    body = await body_of(request)
    return JSONResponse(await run_in_threadpool(_change, state, name, body), 202)


def _change(state: State, name: str, body: dict[str, object]) -> Any:
    parent = state.store.get("takes", name)
    if parent["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    owner = parent["character"]
    ready_character(state, owner)
    form = from_json(ChangeForm, body, "the request")
    apparel = _worn(parent)
    if form.prompt.strip():
        return _edit(state, name, form, apparel)
    seeds = [parent.get("seed", 0)]
    asked: dict[str, Any]
    params: dict[str, Any]
    same: dict[str, Any] = {"apparel": apparel.motion, "stiffness": apparel.stiffness, "gravity": apparel.gravity}
    if form.mirror:
        kind, title, asked, params = "mirror", "mirror", same, same
    elif form.trim:
        kind, title, asked, params = "trim", "trim", same, {**same, "trim": list(form.trim)}
    elif form.apparel is not None:
        kind, title = "dress", "dress anew"
        old = parent.get("asked") or {}
        changed = {
            "apparel": form.apparel, "stiffness": form.stiffness, "gravity": form.gravity,
            "in_place": bool(old.get("in_place")),
        }  # fmt: skip
        asked, params = {**old, **changed}, {**changed, "without": list(form.without)}
    elif form.pins:
        kind, title = "bend", "bend to the pins"
        asked, params = {**same, "pins": list(form.pins)}, {**same, "constraints": form.bends().to_json()}
    else:
        raise OptionError("type what is done instead, or pin a hand or a foot")
    takes = state.new_takes(owner, 1, how=kind, parent=name, script=parent["script"], asked=asked, seeds=seeds)
    return state.make(kind, title, owner, _ids(takes), {**params, "parent": name})


def _edit(state: State, name: str, form: ChangeForm, apparel: Apparel) -> Any:
    """Takes of which parts of another are kept."""
    parent = state.store.get("takes", name)
    owner = parent["character"]
    for pose in form.poses:
        if pose.take is not None and state.store.get("takes", pose.take)["character"] != owner:
            raise OptionError("a pose must be of a take of the same character")
    request = form.request(apparel)
    takes = state.new_takes(
        owner, len(form.seeds), how="edit", parent=parent["id"], script=parent["script"], asked=form.asked(apparel),
        seeds=list(form.seeds),
    )  # fmt: skip
    params = {"request": request.to_json(), "seeds": list(form.seeds), "parent": parent["id"]}
    return state.make("edit", request.prompt, owner, _ids(takes), params)


async def transfer(request: Request) -> Any:
    """A take from a motion file of any kind, in the body."""
    state, owner = studio_state(request), request.path_params["name"]
    ready_character(state, owner)
    title, suffix = plain_name(request.query_params.get("name", ""))
    if suffix not in (*MOTIONS, *CHARACTERS):
        raise FormatError(
            f"{title}{suffix}", f"this is not a format of motions; those are {', '.join(MOTIONS)} and .fbx"
        )
    given = {name: _factor(name, request.query_params.get(name)) for name in ("stiffness", "gravity")}
    given["apparel"] = request.query_params.get("apparel")
    form = from_json(DressForm, {name: value for name, value in given.items() if value is not None})
    apparel = to_json(form)
    onto = request.query_params.get("onto", "handles")
    if onto not in ("auto", "handles"):
        raise OptionError("onto is one of auto, handles")
    about = {"script": [{"text": f"{title}{suffix}", "seconds": 0}], "asked": {"file": title, **apparel}}
    (take,) = await run_in_threadpool(state.new_takes, owner, 1, how="transfer", **about)
    try:
        file = state.store.folder_of("takes", take["id"]) / f"motion-source{suffix}"
        await receive(request, file)
    except BaseException:
        state.drop("takes", take["id"])
        raise
    params = {"file": file.name, **apparel, "onto": onto}
    queued = await run_in_threadpool(state.make, "transfer", f"transfer {title}", owner, [take["id"]], params)
    return JSONResponse(queued, 202)


@beside
def export(request: Request, body: dict[str, Any]) -> Any:
    """Write a take as a file of another program; the job's event says when it is there."""
    state, name = studio_state(request), request.path_params["name"]
    record = state.store.get("takes", name)
    form = from_json(ExportForm, body, "the request")
    if record["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    title = state.store.get("characters", record["character"])["name"]
    named = f"{title}-{_short(record['script'][0]['text'])}.{form.format}"
    params = {"take": name, "character": record["character"], "fps": form.fps}
    return JSONResponse(state.export("export", f"take.{form.format}", named, params, take=name), 202)


@beside
def clips(request: Request, body: dict[str, Any]) -> Any:
    """Write several takes of a character as the clips of one file, each named by its title or its words: a GLB, or what
    the program wants that `preset` names. As a video they stand side by side.
    """
    state, owner = studio_state(request), request.path_params["name"]
    title = state.store.get("characters", owner)["name"]
    form = from_json(ClipsForm, body, "the request")
    records = [state.store.get("takes", name) for name in form.takes]
    if any(record["character"] != owner or record["state"] != "done" for record in records):
        raise OptionError("the clips of one file are finished takes of one character; wait for them, or leave some out")
    names = list(clip_names(record.get("title") or record["script"][0]["text"] for record in records))
    suffix = f".{form.format}"
    if form.preset:
        row = preset_named(form.preset)
        suffix = row.suffix if len(row.files("clips", names)) == 1 else ".zip"
    params = {
        "takes": list(form.takes), "names": names, "character": owner, "fps": form.fps, "preset": form.preset,
        "title": title,
    }  # fmt: skip
    export = state.export("export-clips", f"clips{suffix}", f"{title}-{form.preset or 'clips'}{suffix}", params)
    return JSONResponse({**export, "clips": names}, 202)


def _short(sentence: str) -> str:
    """The first words of a sentence, as a part of a file's name."""
    words = "".join(letter if letter.isalnum() else " " for letter in sentence).split()
    name = words[0][:MOST_NAME] if words else "take"
    for word in words[1:]:
        if len(name) + 1 + len(word) > MOST_NAME:
            break
        name += f"-{word}"
    return name


async def live(request: Request) -> Response:
    """The next poses of a character that never stops, as `clips.packed_clip`. The headers `x-bunraku-session` and
    `x-bunraku-first` give the name of the session and the number of the first pose.
    """
    state, owner = studio_state(request), request.path_params["name"]
    ready_character(state, owner)
    form = from_json(LiveForm, await body_of(request), "the request")
    session = form.session or secrets.token_hex(8)
    params = {**to_json(form), "session": session, "character": owner, "begins": not form.session}
    submit = functools.partial(state.jobs.submit, passing=True, first=True)
    job = await run_in_threadpool(submit, "live", "live", params)
    end = time.monotonic() + PATIENCE
    while job["state"] in OPEN_STATES:
        if time.monotonic() > end:
            await run_in_threadpool(state.jobs.cancel, job["id"])
            raise OptionError("something else is being made, so the character has to wait; ask again when that is done")
        await asyncio.sleep(0.01)
    said = state.windows.pop(job["id"], {})
    if job["state"] != "done":
        raise OptionError(job["error"] or "the window was cancelled; ask again")
    headers = {"x-bunraku-session": session, "x-bunraku-first": str(said["first"])}
    return Response(said["clip"], headers=headers, media_type="application/octet-stream")


@beside
def played(request: Request, body: dict[str, Any]) -> Any:
    """A take of what a character that never stops was seen to do."""
    state, owner = studio_state(request), request.path_params["name"]
    ready_character(state, owner)
    form = from_json(PlayedForm, body, "the request")
    takes = state.new_takes(owner, 1, how="live", script=[{"text": form.text, "seconds": 0}], asked={})
    params = {"session": form.session, "stop": form.stop}
    return JSONResponse(state.make("played", "keep what was played", owner, _ids(takes), params), 202)


async def exported(request: Request) -> Response:
    """The file of an export."""
    state, name = studio_state(request), request.path_params["name"]
    record = state.store.get("exports", name)
    return FileResponse(
        state.store.file("exports", name, record["file"]), filename=record["title"],
        media_type="application/octet-stream",
    )  # fmt: skip


ROUTES = [
    ("/characters/{name}/takes", ("GET", "POST"), takes),
    ("/characters/{name}/transfer", ("POST",), transfer),
    ("/characters/{name}/exports", ("POST",), clips),
    ("/characters/{name}/live", ("POST",), live),
    ("/characters/{name}/live/take", ("POST",), played),
    ("/takes/{name}", ("GET", "PATCH", "DELETE"), take),
    ("/takes/{name}/clip", ("GET",), clip),
    ("/takes/{name}/change", ("POST",), change),
    ("/takes/{name}/exports", ("POST",), export),
    ("/exports/{name}", ("GET",), exported),
]
