"""Takes: made from sentences, changed, carried over from motions, shown, written as files."""

from __future__ import annotations

import asyncio
import functools
import secrets
import time
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.core.request import from_json, to_json
from bunraku.errors import FormatError, OptionError
from bunraku.files import preset_named
from bunraku.pipelines.requests import Apparel, Constraints, clip_names
from bunraku.studio import forms
from bunraku.studio.jobs import OPEN_STATES
from bunraku.studio.routes import reading

PATIENCE = 30
"""Seconds that a live character waits for other jobs."""


@reading.beside(forms.TakeForm, alone=False)
def takes(request: Request, form: forms.TakeForm) -> Any:
    """The takes of a character; POST makes some from a script."""
    state, owner = reading.studio_state(request), request.path_params["name"]
    if request.method == "GET":
        state.store.get("characters", owner)
        return {"takes": [take for take in state.store.all("takes") if take["character"] == owner]}
    handles = reading.ready_character(state, owner)["settings"]["handles"]
    script, seeds = forms.read_script(form.script), [int(seed) for seed in form.seeds]
    params: dict[str, Any]
    if any(part.clip for part in form.script):  # clips of the library are played
        kind, title, constraints = "play", forms.sequence_of(script), form.constraints()
        params = {"pieces": form.pieces(handles), "constraints": constraints.to_json(), **form.dress}
    else:
        drawn = form.request(handles)
        kind, title, params = "animate", drawn.prompt, {"request": drawn.to_json(), "draft": form.draft}
    if form.after:
        before = state.store.get("takes", form.after)
        if before["character"] != owner or before["state"] != "done" or before.get("skin") != "handles":
            raise OptionError("what is followed must be a finished take of handles of the same character")
    about = {"how": "animate", "script": forms.script_json(script), "asked": form.asked()}
    made = state.make_takes(kind, title, owner, {**params, "seeds": seeds}, seeds, **about)
    return JSONResponse({**made, "script": forms.script_json(script)}, 202)


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


@reading.beside(forms.TakeRecordForm)
def take(request: Request, form: forms.TakeRecordForm) -> Any:
    """One take; PATCH stars or names it; DELETE gives it up, which PATCH with `deleted` false takes back."""
    state, name = reading.studio_state(request), request.path_params["name"]
    record = state.store.get("takes", name)
    if request.method == "DELETE":
        return state.change("takes", name, deleted=True)
    if request.method == "PATCH":
        values = {name: value for name, value in to_json(form).items() if value is not None}
        return state.change("takes", name, **values) if values else record
    return record


async def clip(request: Request) -> Response:
    """What the joints of a take do (`clips.packed_clip`): of its draft while there is no more."""
    state, name = reading.studio_state(request), request.path_params["name"]
    file = "clip.bin" if state.store.get("takes", name)["state"] == "done" else "draft.bin"
    return FileResponse(state.store.file("takes", name, file), media_type="application/octet-stream")


@reading.beside(forms.ChangeForm, alone=False)
def change(request: Request, form: forms.ChangeForm) -> Any:
    """New takes from one: parts or poses kept and the rest generated, or bent, mirrored, trimmed, dressed anew."""
    state, name = reading.studio_state(request), request.path_params["name"]
    parent = state.store.get("takes", name)
    if parent["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    owner = parent["character"]
    reading.ready_character(state, owner)
    apparel, seeds = _worn(parent), [parent.get("seed", 0)]
    same: dict[str, Any] = {"apparel": apparel.motion, "stiffness": apparel.stiffness, "gravity": apparel.gravity}
    params, asked = same, same
    if form.prompt.strip():
        for pose in form.poses:
            if pose.take is not None and state.store.get("takes", pose.take)["character"] != owner:
                raise OptionError("a pose must be of a take of the same character")
        edit, seeds = form.request(apparel), list(form.seeds)
        kind, title, asked = "edit", edit.prompt, form.asked(apparel)
        params = {"request": edit.to_json(), "seeds": seeds}
    elif form.mirror:
        kind, title = "mirror", "mirror"
    elif form.trim:
        kind, title, params = "trim", "trim", {**same, "trim": list(form.trim)}
    elif form.apparel is not None:
        kind, title, old = "dress", "dress anew", parent.get("asked") or {}
        dress = {"apparel": form.apparel, "stiffness": form.stiffness, "gravity": form.gravity}
        asked = {**old, **dress, "in_place": bool(old.get("in_place"))}
        params = {**dress, "in_place": asked["in_place"], "without": list(form.without)}
    elif form.pins:
        kind, title, asked = "bend", "bend to the pins", {**same, "pins": to_json(form.pins)}
        params = {**same, "constraints": Constraints(form.pins).to_json()}
    else:
        raise OptionError("type what is done instead, or pin a hand or a foot")
    about = {"how": kind, "parent": name, "script": parent["script"], "asked": asked}
    return JSONResponse(state.make_takes(kind, title, owner, {**params, "parent": name}, seeds, **about), 202)


async def transfer(request: Request) -> Any:
    """A take from a motion file of any kind, in the body."""
    state, owner = reading.studio_state(request), request.path_params["name"]
    reading.ready_character(state, owner)
    title, suffix = reading.plain_name(request.query_params.get("name", ""))
    if suffix not in (*reading.MOTIONS, *reading.CHARACTERS):
        raise FormatError(
            f"{title}{suffix}", f"this is not a format of motions; those are {', '.join(reading.MOTIONS)} and .fbx"
        )
    given = {name: _factor(name, request.query_params.get(name)) for name in ("stiffness", "gravity")}
    given["apparel"] = request.query_params.get("apparel")
    form = from_json(forms.DressForm, {name: value for name, value in given.items() if value is not None})
    apparel = to_json(form)
    onto = request.query_params.get("onto", "handles")
    if onto not in ("auto", "handles"):
        raise OptionError("onto is one of auto, handles")
    about = {"script": [{"text": f"{title}{suffix}", "seconds": 0}], "asked": {"file": title, **apparel}}
    (take,) = await run_in_threadpool(state.new_takes, owner, 1, how="transfer", **about)
    try:
        file = state.store.folder_of("takes", take["id"]) / f"motion-source{suffix}"
        await reading.receive(request, file)
    except BaseException:
        state.drop("takes", take["id"])
        raise
    params = {"file": file.name, **apparel, "onto": onto}
    queued = await run_in_threadpool(state.make, "transfer", f"transfer {title}", owner, [take["id"]], params)
    return JSONResponse(queued, 202)


@reading.beside(forms.ExportForm)
def export(request: Request, form: forms.ExportForm) -> Any:
    """Write a take as a file of another program; the job's event says when it is there."""
    state, name = reading.studio_state(request), request.path_params["name"]
    record = state.store.get("takes", name)
    if record["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    title = state.store.get("characters", record["character"])["name"]
    named = f"{title}-{next(iter(clip_names([record['script'][0]['text']])))}.{form.format}"
    params = {"take": name, "character": record["character"], "fps": form.fps}
    return JSONResponse(state.export("export", f"take.{form.format}", named, params, take=name), 202)


@reading.beside(forms.ClipsForm)
def clips(request: Request, form: forms.ClipsForm) -> Any:
    """Write several takes of a character as the clips of one file, each named by its title or its words: a GLB, or what
    the program wants that `preset` names. As a video they stand side by side.
    """
    state, owner = reading.studio_state(request), request.path_params["name"]
    title = state.store.get("characters", owner)["name"]
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


@reading.beside(forms.LiveForm)
async def live(request: Request, form: forms.LiveForm) -> Response:
    """The next poses of a character that never stops, as `clips.packed_clip`. The headers `x-bunraku-session` and
    `x-bunraku-first` give the name of the session and the number of the first pose.
    """
    state, owner = reading.studio_state(request), request.path_params["name"]
    reading.ready_character(state, owner)
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


@reading.beside(forms.PlayedForm)
def played(request: Request, form: forms.PlayedForm) -> Any:
    """A take of what a character that never stops was seen to do."""
    state, owner = reading.studio_state(request), request.path_params["name"]
    reading.ready_character(state, owner)
    about = {"how": "live", "script": [{"text": form.text, "seconds": 0}], "asked": {}}
    params = {"session": form.session, "stop": form.stop}
    return JSONResponse(state.make_takes("played", "keep what was played", owner, params, [0], **about), 202)


async def exported(request: Request) -> Response:
    """The file of an export."""
    state, name = reading.studio_state(request), request.path_params["name"]
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
