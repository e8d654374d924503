"""What a request brings, checked: JSON within bounds, uploads streamed to disk."""

from __future__ import annotations

import functools
import inspect
import re
import zipfile
from collections.abc import Awaitable, Callable
from contextlib import nullcontext, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from bunraku.core.files import path_inside, writing
from bunraku.core.request import from_json, read_json
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.files import READERS
from bunraku.studio.projects import copy_entry, open_archive
from bunraku.studio.state import State

MOST_BYTES = 200 << 20
"""Bytes of an upload."""
MOST_REFUSED = 1 << 30
"""Bytes that are read of an upload that is refused, and not kept, so that its sender gets the answer."""
MOST_UNPACKED = 600 << 20
MOST_ENTRIES = 2000
CHARACTERS = tuple(READERS["character"])
"""Suffixes of what becomes a character."""
MOTIONS = (".bvh", ".vmd", ".vrma", ".npz", ".npy")
"""Suffixes of what is a motion and nothing else."""
PROJECTS = (".bunraku",)
_BESIDE = (
    ".png",
    ".jpg",
    ".jpeg",
    ".bmp",
    ".tga",
    ".dds",
    ".webp",
    ".sph",
    ".spa",
    ".bin",
    ".mtl",
    ".toml",
    *CHARACTERS,
)


Route = Callable[[Request], Awaitable[Any]]


class TooLarge(BunrakuError):
    """More bytes than are taken."""


def plain_name(name: str) -> tuple[str, str]:
    """A title and a suffix of a client's file name, without its folders; the suffix is lower case."""
    path = PurePosixPath(name.replace("\\", "/"))
    title = re.sub(r"[^\w .()-]+", " ", path.stem).strip(" .")[:80] or "character"
    suffix = path.suffix.lower()
    return title, suffix if re.fullmatch(r"\.[a-z0-9]{1,8}", suffix) else ""


async def receive(request: Request, path: Path) -> None:
    """Write the body of a request to a file; an incomplete file is removed.

    Raises:
        TooLarge: It has more bytes than are taken.
        FormatError: The connection broke, the body is empty, or the file cannot be written.
    """
    declared = request.headers.get("content-length", "")
    size, complete, chunks = 0, False, request.stream()
    try:
        if declared.isdecimal() and int(declared) > MOST_BYTES:
            mib = int(declared) >> 20
            raise TooLarge(f"{path.name}: {mib} MiB are too many, at most {MOST_BYTES >> 20} are taken; simplify it")
        with writing(path), path.open("wb") as file:
            async for chunk in chunks:
                size += len(chunk)
                if size > MOST_BYTES:
                    raise TooLarge(f"{path.name}: more than {MOST_BYTES >> 20} MiB are not taken; simplify it")
                file.write(chunk)
        if not size:
            raise FormatError(path.name, "the file is empty; export it again")
        if declared.isdecimal() and size != int(declared):
            raise FormatError(path.name, "it did not arrive in full; drop it again")
        complete = True
    except ClientDisconnect:
        raise FormatError(path.name, "it did not arrive in full; drop it again") from None
    finally:
        if not complete:
            path.unlink(missing_ok=True)
            with suppress(ClientDisconnect):  # a sender gets no answer while it sends
                async for chunk in chunks:
                    size += len(chunk)
                    if size > MOST_REFUSED:
                        break


def unpack(archive: Path, folder: Path) -> str:
    """Unpack the character of a ZIP with the files beside it, and give back its file, relative to the folder;
    FormatError where the ZIP is broken, unpacks to too much, names a path outside, or holds no character.
    """
    names: list[str] = []
    with open_archive(archive, MOST_ENTRIES, MOST_UNPACKED) as opened:
        for entry in opened.infolist():
            if entry.is_dir():
                continue
            target = path_inside(folder, _decoded(entry))
            if target is None:
                raise FormatError(archive.name, "a file in it would lie outside its folder; pack it again")
            if target.suffix.lower() not in _BESIDE:
                continue
            copy_entry(opened, entry, target)
            if target.suffix.lower() in CHARACTERS:
                names.append(target.relative_to(folder.resolve()).as_posix())
    if not names:
        raise FormatError(archive.name, f"there is no character in it; characters are {', '.join(CHARACTERS)}")
    return min(names, key=lambda name: (name.count("/"), CHARACTERS.index(Path(name).suffix.lower()), name))


def _decoded(entry: zipfile.ZipInfo) -> str:
    """The name of an entry; ZIPs of MMD models are packed in Japan, whose names are in Shift JIS."""
    if entry.flag_bits & 0x800:
        return entry.filename
    try:
        return entry.filename.encode("cp437").decode("shift_jis")
    except UnicodeError:
        return entry.filename


MOST_JSON = 4 << 20


def studio_state(request: Request) -> State:
    """The state behind the routes."""
    state = request.app.state.studio
    assert isinstance(state, State)
    return state


def ready_character(state: State, name: str) -> dict[str, Any]:
    """The record of a character that is open; OptionError where it is not, NotThere where there is none."""
    record = state.store.get("characters", name)
    if record["state"] != "ready":
        raise OptionError(f"{record['name']} is not open yet ({record['error'] or record['state']}); wait for it")
    return record


async def data_of(request: Request, most: int, refused: Exception) -> bytes:
    """The bytes of a request; `refused` where they are more than `most`."""
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > most:
            raise refused
    return bytes(data)


async def body_of(request: Request, most: int = MOST_JSON) -> dict[str, Any]:
    """The JSON object of a request; OptionError where it is none, or has more bytes than are taken."""
    refused = OptionError(f"a request of more than {most >> 10:,} KiB is not taken")
    body = read_json(await data_of(request, most, refused) or b"{}", "the request", MOST_JSON)
    if not isinstance(body, dict):
        raise OptionError("the request is not a JSON object")
    return body


def beside(form: type | None = None, alone: bool = True) -> Callable[[Callable[[Request, Any], Any]], Route]:
    """A route that runs in another thread than the one that answers, so a slow disk holds up no other request. It is
    called with the request and its body: an object, or the dataclass that it is read as; {} where there is none. Routes
    that write run `alone`, one after the other, so what one has looked up holds until it has written; those that wait
    are coroutines, and run where the others are answered.
    """

    def decorated(handler: Callable[[Request, Any], Any]) -> Route:
        def work(request: Request, body: Any) -> Any:
            with studio_state(request).writing if alone else nullcontext():
                return handler(request, body)

        @functools.wraps(handler)
        async def route(request: Request) -> Any:
            body: Any = {}
            if request.method not in ("GET", "DELETE"):
                body = await body_of(request)
                body = body if form is None else from_json(form, body, "the request")
            if inspect.iscoroutinefunction(handler):
                return await handler(request, body)
            return await run_in_threadpool(work, request, body)

        route.form = form  # type: ignore[attr-defined]  # for the OpenAPI document
        return route

    return decorated
