"""Characters: dropped, sampled, repaired, shown."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response

from bunraku.core.body.corrections import SUFFIX, Corrections, read_corrections, write_corrections
from bunraku.core.files import atomic_write, writing
from bunraku.errors import FormatError, OptionError
from bunraku.studio.dressing import WORN, clean_mask, found_mask, has_apparel, paint, painted_file, shown_mask
from bunraku.studio.forms import CharacterForm
from bunraku.studio.routes import reading
from bunraku.studio.state import State
from bunraku.studio.workspace import Settings

PICTURE = "picture"
"""The file of a character's picture."""
PNG = b"\x89PNG"
SKINS = {"bones": "bones.glb", "chains": "chains.glb"}
MOST_MASK = 1 << 20
"""Bytes of a painted mask, which has a bit for each vertex."""
MOST_PICTURE = 128 << 10
UNTOUCHED = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}


async def characters(request: Request) -> Any:
    """All characters; POST adds one, from the body or a sample."""
    state = reading.studio_state(request)
    if request.method == "GET":
        return {"characters": state.store.all("characters")}
    sample = request.query_params.get("sample")
    if sample:
        return JSONResponse(await run_in_threadpool(_sampled, state, sample), 202)
    title, suffix = reading.plain_name(request.query_params.get("name", ""))
    if suffix not in (*reading.CHARACTERS, ".zip"):
        raise FormatError(
            f"{title}{suffix}",
            f"this is not a format of characters; those are {', '.join((*reading.CHARACTERS, '.zip'))}",
        )
    record = await run_in_threadpool(state.store.new, "characters", _fresh(title, ""))
    folder = state.store.folder_of("characters", record["id"])
    try:
        source = folder / "source"
        source.mkdir()
        file = source / f"{title}{suffix}"
        await reading.receive(request, file)
        name = file.relative_to(folder).as_posix()
        if suffix == ".zip":
            name = f"source/{await run_in_threadpool(reading.unpack, file, source)}"
            file.unlink()
        return JSONResponse(await run_in_threadpool(state.open, record["id"], name), 202)
    except BaseException:
        state.store.drop("characters", record["id"])
        raise


def _fresh(title: str, file: str) -> dict[str, Any]:
    return {"name": title, "file": file, "settings": dict(UNTOUCHED), "state": "opening", "error": "", "version": 0}


def _sampled(state: State, sample: str) -> dict[str, Any]:
    from bunraku.files import sample_file

    file = sample_file(sample)
    record = state.store.new("characters", {**_fresh(sample, ""), "sample": sample})
    try:
        source = state.store.folder_of("characters", record["id"]) / "source"
        source.mkdir()
        shutil.copyfile(file, source / f"{sample}.glb")
        return state.open(record["id"], f"source/{sample}.glb")
    except BaseException:
        state.store.drop("characters", record["id"])
        raise


@reading.beside(CharacterForm)
def character(request: Request, form: CharacterForm) -> Any:
    """One character; PATCH renames it, turns it, changes its unit or where its handles come from; DELETE gives it up
    until the studio starts again, and PATCH with `deleted` false takes that back.
    """
    state, name = reading.studio_state(request), request.path_params["name"]
    record = state.store.get("characters", name)
    if request.method == "DELETE":
        return state.change("characters", name, deleted=True)
    if request.method == "GET":
        return record
    if form.deleted is False:
        record = state.change("characters", name, deleted=False)
    if form.name is not None:
        record = state.change("characters", name, name=reading.plain_name(f"{form.name}.x")[0])
    old = record["settings"]
    settings = {key: getattr(form, key) or old[key] for key in UNTOUCHED}
    if settings == old and record["state"] in ("ready", "opening"):
        return record
    Settings(**settings)  # refuses axes that do not go together
    if record["state"] == "opening":
        raise OptionError("this character is being opened; wait for it, or cancel it")
    state.change("characters", name, settings=settings)
    opened = state.open(name, record["file"])
    return JSONResponse(opened, 202)


@reading.beside(Corrections)
def body(request: Request, form: Corrections | dict[str, Any]) -> Any:
    """What a person says about a body: PUT takes axes, joints and parts as the file of corrections has them
    (`core.body.corrections`), DELETE takes all of it back. The character opens again; its record has them as `body`.
    """
    state, name = reading.studio_state(request), request.path_params["name"]
    record = state.store.get("characters", name)
    file = state.store.folder_of("characters", name) / record["file"]
    said = form if isinstance(form, Corrections) else Corrections()
    if record["state"] == "opening":
        raise OptionError("this character is being opened; wait for it, or cancel it")
    old = read_corrections(file) or Corrections()
    if said == Corrections():
        file.with_name(f"{file.stem}{SUFFIX}").unlink(missing_ok=True)
    else:
        write_corrections(file.with_name(f"{file.stem}{SUFFIX}"), said, ("+y", "+z"), {}, [])
    return JSONResponse(state.open(name, record["file"], again=_apart(said) == _apart(old)), 202)


def _apart(said: Corrections) -> tuple[object, ...]:
    """What of corrections changes the mesh that handles are guessed from."""
    return said.up, said.front, said.character, [piece for piece in said.part if piece.kind == "ground"]


async def mesh(request: Request) -> Response:
    """The mesh with its skin, and no clip; `?skin=bones` for takes that move the file's own bones, `?skin=chains` with
    chains of bones for hair and clothes, whose springs stand in the extras.
    """
    state, name = reading.studio_state(request), request.path_params["name"]
    file = SKINS.get(request.query_params.get("skin", ""), "mesh.glb")
    return FileResponse(state.store.file("characters", name, file), media_type="model/gltf-binary")


async def picture(request: Request) -> Any:
    """How a character looks on its card: PUT keeps a WebP or PNG that the page drew."""
    state, name = reading.studio_state(request), request.path_params["name"]
    if request.method == "GET":
        path = state.store.file("characters", name, PICTURE)
        kind = "image/png" if path.read_bytes()[:4] == PNG else "image/webp"
        return FileResponse(path, media_type=kind)
    record = state.store.get("characters", name)  # it may be opening again: then another picture follows
    refused = reading.TooLarge(f"a picture of more than {MOST_PICTURE >> 10} KiB is not taken; draw a smaller one")
    data = await reading.data_of(request, MOST_PICTURE, refused)
    if data[:4] != PNG and (data[:4] != b"RIFF" or data[8:12] != b"WEBP"):
        raise FormatError("picture", "it is neither a PNG nor a WebP; draw it again")
    return await run_in_threadpool(_pictured, state, record, data)


def _pictured(state: State, record: dict[str, Any], data: bytes) -> dict[str, Any]:
    with atomic_write(state.store.folder_of("characters", record["id"]) / PICTURE) as file:
        file.write(data)
    return state.note("characters", record["id"], picture=record["version"])


async def mask(request: Request) -> Any:
    """Which vertices are hair and clothes: GET gives the painted mask, or else the found one; PUT takes a painted one,
    for all takes from then on; DELETE goes back to the found one.
    """
    state, name = reading.studio_state(request), request.path_params["name"]
    record = reading.ready_character(state, name)
    worn = state.store.file("characters", name, WORN)
    painted = painted_file(state.store.folder_of("characters", name) / record["file"])
    if request.method == "GET":
        return Response(await run_in_threadpool(shown_mask, worn, painted), media_type="application/octet-stream")
    refused = reading.TooLarge(f"a mask of more than {MOST_MASK >> 20} MiB is not taken; reload the page")
    bits = await reading.data_of(request, MOST_MASK, refused)
    return await run_in_threadpool(_painted, state, record, worn, painted, bits, request.method == "DELETE")


def _painted(
    state: State, record: dict[str, Any], worn: Path, painted: Path, bits: bytes, back: bool
) -> dict[str, Any]:  # fmt: skip
    with state.writing:
        chosen = found_mask(worn) if back else clean_mask(worn, bits)
        if back:
            painted.unlink(missing_ok=True)
        else:
            paint(chosen, painted)
        state.lay_chains(record["id"])
        return state.note("characters", record["id"], painted=not back, apparel=has_apparel(chosen))


@reading.beside()
def copy(request: Request, body: dict[str, Any]) -> Any:
    """The same file as another character, to try other handles or axes beside it."""
    state, name = reading.studio_state(request), request.path_params["name"]
    old = state.store.get("characters", name)
    record = state.store.new("characters", {**_fresh(f"{old['name']} copy"[:80], ""), "settings": old["settings"]})
    source, target = (state.store.folder_of("characters", key) / "source" for key in (name, record["id"]))
    try:
        with writing(target, "copy"):
            shutil.copytree(source, target)
        return JSONResponse(state.open(record["id"], old["file"]), 202)
    except BaseException:
        state.store.drop("characters", record["id"])
        raise


ROUTES = [
    ("/characters", ("GET", "POST"), characters),
    ("/characters/{name}", ("GET", "PATCH", "DELETE"), character),
    ("/characters/{name}/body", ("PUT", "DELETE"), body),
    ("/characters/{name}/mesh.glb", ("GET",), mesh),
    ("/characters/{name}/picture", ("GET", "PUT"), picture),
    ("/characters/{name}/mask", ("GET", "PUT", "DELETE"), mask),
    ("/characters/{name}/copy", ("POST",), copy),
]
