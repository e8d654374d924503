"""Takes: made from sentences, changed, carried over from motions, shown, written as files."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.errors import FormatError, OptionError
from bunraku.studio.routes.asked import body_of, choice, number, path_of, sampling, state_of, text, things
from bunraku.studio.state import State
from bunraku.studio.uploads import CHARACTERS, MOTIONS, plain_name, receive

__all__ = ["ROUTES"]

SUFFIXES = ("glb", "bvh", "vrma", "vmd", "npz", "fbx", "usdz", "usdc", "mp4", "gif")
WAYS = ("rigid", "simulate", "learn")
"""How apparel moves."""


def _script(body: dict[str, Any]) -> tuple[str, float]:
    """The sentences of a request as a sequence, and how long all of it is [s].

    Raises:
        OptionError: A sentence is empty, or a length out of range.
    """
    from bunraku.language.sequence import parse_sequence, timed_sequence

    parts: list[tuple[str, float]] = []
    for part in things(body, "script", 20):
        if not isinstance(part, dict):
            raise OptionError("a script is a list of texts with seconds")
        words = text(part, "text", 1000).replace("\n", " ").strip()
        parts += timed_sequence(parse_sequence(words), number(part, "seconds", 0.5, 120, 4))
    if not parts:
        raise OptionError("type what the character does, such as: walks forward, then waves")
    script = "; ".join(f"{words}:{seconds:g}" for words, seconds in parts)
    return script, sum(seconds for _, seconds in timed_sequence(parse_sequence(script), 6.0))


def _ready(state: State, name: str) -> dict[str, Any]:
    record = state.store.get("characters", name)
    if record["state"] != "ready":
        raise OptionError(f"{record['name']} is not open yet ({record['error'] or record['state']}); wait for it")
    return record


async def takes(request: Request) -> Any:
    """The takes of a character; POST makes some from a script."""
    state, owner = state_of(request), request.path_params["name"]
    if request.method == "GET":
        state.store.get("characters", owner)
        return {"takes": [take for take in state.store.all("takes") if take["character"] == owner]}
    body = await body_of(request)
    return JSONResponse(await run_in_threadpool(_make, state, owner, body), 202)


def _make(state: State, owner: str, body: dict[str, Any]) -> Any:
    from bunraku.language.sequence import parse_sequence
    from bunraku.language.understood import check_understood

    character = _ready(state, owner)
    script, seconds = _script(body)
    how = sampling(body)
    for sentence, _ in parse_sequence(script):
        check_understood(sentence, how["anyway"])
    params = {
        **how, "script": script, "seconds": seconds, "draft": body.get("draft", True) is not False,
        "loop": bool(body.get("loop")), "in_place": bool(body.get("in_place")),
        **_apparel(body), "path": path_of(body),
        "after": body["after"] if body.get("after") else None, "handles": character["settings"]["handles"],
    }  # fmt: skip
    if params["after"] is not None:
        before = state.store.get("takes", params["after"])
        if before["character"] != owner or before["state"] != "done" or before.get("skin") != "handles":
            raise OptionError("what is followed must be a finished take of handles of the same character")
    kept = ("seeds", "steps", "guidance", "loop", "in_place", "apparel", "stiffness", "path", "pins")
    asked = {name: params[name] for name in kept}
    made = state.new_takes(
        owner, len(how["seeds"]), how="animate", script=body["script"], asked=asked, seeds=how["seeds"]
    )
    return state.make("animate", script, owner, made, params)


def _apparel(body: dict[str, Any]) -> dict[str, Any]:
    """How apparel moves, checked."""
    return {
        "apparel": choice(body, "apparel", WAYS, "rigid"),
        "stiffness": number(body, "stiffness", 0.001, 1000, 1.0),
    }


def _factor(word: str | None) -> float | None:
    """A number of an address."""
    try:
        return None if word is None else float(word)
    except ValueError:
        raise OptionError("stiffness must be a number") from None


async def take(request: Request) -> Any:
    """One take; PATCH stars or names it; DELETE gives it up, which PATCH with `deleted` false takes back."""
    state, name = state_of(request), request.path_params["name"]
    record = state.store.get("takes", name)
    if request.method == "DELETE":
        return state.change("takes", name, deleted=True)
    if request.method == "PATCH":
        body = await body_of(request)
        values: dict[str, Any] = {key: bool(body[key]) for key in ("star", "deleted") if key in body}
        if "title" in body:
            values["title"] = text(body, "title", 80)
        return state.change("takes", name, **values) if values else record
    return record


async def clip(request: Request) -> Response:
    """What the joints of a take do (`clips.packed_clip`): of its draft while there is no more."""
    state, name = state_of(request), request.path_params["name"]
    file = "clip.bin" if state.store.get("takes", name)["state"] == "done" else "draft.bin"
    return FileResponse(state.store.file("takes", name, file), media_type="application/octet-stream")


async def change(request: Request) -> Any:
    """New takes from one: parts or poses kept and the rest generated, or bent to pins with nothing generated."""
    state, name = state_of(request), request.path_params["name"]
    body = await body_of(request)
    return JSONResponse(await run_in_threadpool(_change, state, name, body), 202)


def _change(state: State, name: str, body: dict[str, Any]) -> Any:
    from bunraku.language.understood import check_understood

    parent = state.store.get("takes", name)
    if parent["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    _ready(state, parent["character"])
    how = sampling(body)
    prompt = text(body, "prompt", 1000).strip()
    worn = {"apparel": "learn" if parent.get("stiffness") else "rigid", "stiffness": parent.get("stiffness") or 1.0}
    params: dict[str, Any] = {**how, **worn, "parent": name, "prompt": prompt}
    if not prompt:
        kind, asked = "bend", {**worn, "pins": how["pins"]}
        if "apparel" in body:
            kind = "dress"
            in_place = bool((parent.get("asked") or {}).get("in_place"))
            asked = {**(parent.get("asked") or {}), **_apparel(body), "in_place": in_place}
        elif not how["pins"]:
            raise OptionError("type what is done instead, or pin a hand or a foot")
        made = state.new_takes(parent["character"], 1, how=kind, parent=name, script=parent["script"], asked=asked,
                              seeds=[parent.get("seed", 0)])  # fmt: skip
        title = "bend to the pins" if kind == "bend" else "dress anew"
        return state.make(kind, title, parent["character"], made, {**params, **asked})
    check_understood(prompt, how["anyway"])
    keep = [str(part) for part in things(body, "keep", 40)]
    if keep:
        from bunraku.body.parts import kept_handles

        kept_handles(keep)
    span = [number({"span": value}, "span", 0, 120) for value in things(body, "span", 2)]
    if len(span) == 1 or None in span:
        raise OptionError("a span is two seconds, from and to")
    poses = []
    for pose in things(body, "poses", 100):
        if not isinstance(pose, dict):
            raise OptionError("a pose has a time")
        time = number(pose, "time", 0, 120, 0)
        source = pose.get("take")
        if source is not None and state.store.get("takes", source)["character"] != parent["character"]:
            raise OptionError("a pose must be of a take of the same character")
        poses.append({"time": time, "take": source, "at": number(pose, "at", 0, 120, time)})
    if not keep and not span and not poses:
        raise OptionError("nothing is kept: select a span of time, keep parts of the body, or pin poses")
    params |= {"keep": keep, "span": span or None, "poses": poses}
    asked = {key: params[key] for key in ("seeds", "keep", "span", "poses", "pins", "prompt", "apparel", "stiffness")}
    made = state.new_takes(
        parent["character"], len(how["seeds"]), how="edit", parent=name, script=parent["script"], asked=asked,
        seeds=how["seeds"],
    )  # fmt: skip
    return state.make("edit", prompt, parent["character"], made, params)


async def transfer(request: Request) -> Any:
    """A take from a motion file of any kind, in the body."""
    state, owner = state_of(request), request.path_params["name"]
    _ready(state, owner)
    title, suffix = plain_name(request.query_params.get("name", ""))
    if suffix not in (*MOTIONS, *CHARACTERS):
        raise FormatError(f"{title}{suffix}", f"this is no format of motions; they are {', '.join(MOTIONS)} and .fbx")
    worn = _apparel({**request.query_params, "stiffness": _factor(request.query_params.get("stiffness"))})
    onto = choice(dict(request.query_params), "onto", ("auto", "handles"), "handles")
    (made,) = state.new_takes(
        owner, 1, how="transfer", script=[{"text": title, "seconds": 0}], asked={"file": title, **worn}
    )
    try:
        file = state.store.place("takes", made["id"]) / f"motion-source{suffix}"
        await receive(request, file)
    except BaseException:
        state.drop("takes", made["id"])
        raise
    params = {"file": file.name, **worn, "onto": onto}
    return JSONResponse(state.make("transfer", f"transfer {title}", owner, [made], params), 202)


async def export(request: Request) -> Any:
    """Write a take as a file of another program; the job's event says when it is there."""
    state, name = state_of(request), request.path_params["name"]
    record = state.store.get("takes", name)
    body = await body_of(request)
    suffix = choice(body, "format", SUFFIXES, "glb")
    fps = number(body, "fps", 1, 120, 30)
    if record["state"] != "done":
        raise OptionError("this take is not finished; wait for it")
    title = state.store.get("characters", record["character"])["name"]
    words = "-".join("".join(c if c.isalnum() else " " for c in record["script"][0]["text"][:40]).split()) or "take"
    made = state.store.new("exports", {"file": f"take.{suffix}", "title": f"{title}-{words}.{suffix}"})
    try:
        job = state.jobs.submit(
            "export",
            f"write {made['title']}",
            {
                "export": made["id"], "file": made["file"], "take": name, "character": record["character"], "fps": fps,
            },
            {"export": made["id"], "take": name},
        )  # fmt: skip
    except BaseException:
        state.store.drop("exports", made["id"])
        raise
    return JSONResponse({"job": job["id"], "export": made["id"], "title": made["title"]}, 202)


async def exported(request: Request) -> Response:
    """The file of an export."""
    state, name = state_of(request), request.path_params["name"]
    record = state.store.get("exports", name)
    return FileResponse(
        state.store.file("exports", name, record["file"]), filename=record["title"],
        media_type="application/octet-stream",
    )  # fmt: skip


ROUTES = [
    ("/characters/{name}/takes", ("GET", "POST"), takes),
    ("/characters/{name}/transfer", ("POST",), transfer),
    ("/takes/{name}", ("GET", "PATCH", "DELETE"), take),
    ("/takes/{name}/clip", ("GET",), clip),
    ("/takes/{name}/change", ("POST",), change),
    ("/takes/{name}/exports", ("POST",), export),
    ("/exports/{name}", ("GET",), exported),
]
