"""A project as one file, `.bunraku`: a ZIP, read within bounds, with a character, its takes and the page's view."""

from __future__ import annotations

import errno
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bunraku.core.files import atomic_write, path_inside, writing
from bunraku.core.request import read_json
from bunraku.errors import FormatError, OptionError
from bunraku.studio.forms import check_asked
from bunraku.studio.records import CHARACTER_FACTS, TAKE_FACTS, check_facts, read_view
from bunraku.studio.store import Store

_DAMAGED = "the file is damaged or has a password; pack or save it again"
_END = struct.Struct("<4s4H2LH")
_LARGEST_ENTRY = 600
"""Most bytes of an entry in the directory, on average."""


@contextmanager
def open_archive(path: Path, entries: int, size: int) -> Iterator[zipfile.ZipFile]:
    """The archive of a file, with at most so many entries that unpack to at most `size` bytes; FormatError where it is
    broken, has a password, is packed in a rare way, or is too large, also where that is found within the block.
    """
    try:
        _check_directory(path, entries)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > entries or sum(entry.file_size for entry in members) > size:
                raise FormatError(
                    path.name, f"it unpacks to too much, at most {size >> 20} MiB in {entries:,} files are taken"
                )
            if any(member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for member in members):
                raise FormatError(path.name, "it is packed in a rare way; pack it again as an ordinary ZIP")
            yield archive
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error) as error:
        raise FormatError(path.name, _DAMAGED) from error
    except OSError as error:
        if error.errno != errno.EINVAL:  # which says that the directory names bytes before the file
            raise
        raise FormatError(path.name, _DAMAGED) from error


def _check_directory(path: Path, entries: int) -> None:
    """Refuse a directory that is larger than so many entries need: Python makes objects of all of it at once."""
    with path.open("rb") as file:
        length = file.seek(0, 2)
        file.seek(max(0, length - _END.size - 0xFFFF))
        tail = file.read()
    start = tail.rfind(b"PK\x05\x06")
    if start < 0 or len(tail) - start < _END.size:
        raise zipfile.BadZipFile
    many, directory = _END.unpack_from(tail, start)[4:6]
    if tail[max(0, start - 20) : start].startswith(b"PK\x06\x07") or many > entries:
        raise FormatError(path.name, f"it has too many files, at most {entries:,} are taken; pack fewer")
    if directory > entries * _LARGEST_ENTRY:
        raise FormatError(path.name, "its directory is too large; pack it again")


def read_entry(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """The bytes of an entry, at most `most` and one; KeyError where there is none."""
    with archive.open(name) as source:
        return source.read(most + 1)


def copy_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Write an entry to a file; FormatError where the file cannot be written, or the entry is longer than it says."""
    left = entry.file_size
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(entry) as source, writing(target), target.open("wb") as out:
        while chunk := source.read(1 << 20):
            left -= len(chunk)
            if left < 0:
                raise FormatError(target.name, "it unpacks to more than it says; pack it again")
            out.write(chunk)


VERSION = 1
MOST_UNPACKED = 1 << 30
MOST_ENTRIES = 8000
MOST_JSON = 8 << 20
"""Bytes of what a project says of itself."""
_FILES = ("mesh.glb", "handles.npz", "bones.glb", "chains.glb", "worn.bin")
_TAKE_FILES = ("clip.bin", "motion.npz")
_MAY_HAVE = "apparel.npz"
"""Of takes whose apparel is learned."""


def pack_project(store: Store, character: str, view: dict[str, object], path: Path) -> None:
    """Write a project with a character and its finished takes; NotThere where there is no such character, FormatError
    where the file cannot be written.
    """
    record, home = store.get("characters", character), store.folder_of("characters", character)
    takes = [take for take in store.all("takes") if take["character"] == character and take["state"] == "done"]
    about = {
        "version": VERSION,
        "character": {name: record[name] for name in CHARACTER_FACTS if name in record},
        "takes": [{**{name: take[name] for name in TAKE_FACTS if name in take}, "was": take["id"]} for take in takes],
        "view": view,
    }
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr(_entry("project.json"), json.dumps(about, ensure_ascii=False, sort_keys=True))
        for name in _FILES:
            if (home / name).is_file():
                out.writestr(_entry(f"character/{name}"), (home / name).read_bytes())
        for source in sorted((home / "source").rglob("*")):
            if source.is_file():
                out.writestr(_entry(f"character/{source.relative_to(home).as_posix()}"), source.read_bytes())
        for take in takes:
            folder = store.folder_of("takes", take["id"])
            for name in (*_TAKE_FILES, *((_MAY_HAVE,) if (folder / _MAY_HAVE).is_file() else ())):
                data = (folder / name).read_bytes()
                out.writestr(_entry(f"takes/{take['id']}/{name}"), data)


def _entry(name: str) -> zipfile.ZipInfo:
    """An entry without the time of day, so that the same project is the same file."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def unpack_project(store: Store, path: Path) -> dict[str, Any]:
    """Add the character and takes of a project to the store: the character's id, and how the page stood; FormatError
    where the file is broken, no project, or too large.
    """
    written: list[tuple[str, str]] = []
    try:
        with open_archive(path, MOST_ENTRIES, MOST_UNPACKED) as archive:
            about = _read_about(archive)
            version = about["version"]
            if version != VERSION:
                raise FormatError(path.name, "it was saved by another version of Bunraku; open it with that one")
            return _added(store, path.name, archive, about, written)
    except OptionError as error:
        _undo(store, written)
        raise FormatError(path.name, f"{error}; save the project again") from None
    except (KeyError, TypeError, AttributeError):
        _undo(store, written)
        raise FormatError(path.name, "it is not a project of Bunraku, or it is broken; save it again") from None
    except BaseException:
        _undo(store, written)
        raise


def _read_about(archive: zipfile.ZipFile) -> dict[str, Any]:
    """What a project says; OptionError where it says anything that a project cannot say."""
    about = read_json(read_entry(archive, "project.json", MOST_JSON), "project.json", MOST_JSON)
    if about["version"] == VERSION:
        check_facts(
            "characters", {name: about["character"][name] for name in CHARACTER_FACTS if name in about["character"]}
        )
        if not isinstance(about["takes"], list):
            raise OptionError("takes must be a list")
        if len({str(take["was"]) for take in about["takes"]}) < len(about["takes"]):
            raise OptionError("two of its takes are stored in the same files")
        for take in about["takes"]:
            check_facts("takes", {name: take[name] for name in TAKE_FACTS if name in take})
            check_asked(take.get("how"), take.get("script"), take.get("asked"))
    return dict(about)


def _added(
    store: Store, title: str, archive: zipfile.ZipFile, about: dict[str, Any], made: list[tuple[str, str]]
) -> dict[str, Any]:
    """Add a checked project to the store; `made` gets each thing as it is begun."""
    store.check_takes(len(about["takes"]))
    old = about["character"]
    fresh = {name: old[name] for name in CHARACTER_FACTS if name in old}
    character = store.new("characters", {**fresh, "state": "opening", "error": "", "version": 1})
    made.append(("characters", character["id"]))
    folder = store.folder_of("characters", character["id"])
    if path_inside(folder, fresh["file"]) is None or not fresh["file"].startswith("source/"):
        raise FormatError(title, "its character lies outside the project; save it again")
    for entry in archive.infolist():
        if entry.filename.startswith("character/") and not entry.is_dir():
            name = entry.filename.removeprefix("character/")
            target = path_inside(folder, name)
            if target is None or (name not in _FILES and not name.startswith("source/")):
                raise FormatError(title, "a file in it would lie outside its folder; save it again")
            copy_entry(archive, entry, target)
    names = {}
    for take in about["takes"]:
        values = {name: take[name] for name in TAKE_FACTS if name in take}
        new = store.new("takes", {"error": "", **values, "character": character["id"], "state": "waiting"})
        made.append(("takes", new["id"]))
        names[str(take["was"])] = new["id"]
        was_kept = f"takes/{take['was']}/{_MAY_HAVE}" in archive.NameToInfo
        for file in (*_TAKE_FILES, *((_MAY_HAVE,) if was_kept else ())):
            target = store.folder_of("takes", new["id"]) / file
            copy_entry(archive, archive.getinfo(f"takes/{take['was']}/{file}"), target)
        store.change("takes", new["id"], state="done")
    store.change("characters", character["id"], state="ready")
    return {"character": character["id"], "takes": names, "view": read_view(about.get("view"))}


def _undo(store: Store, made: list[tuple[str, str]]) -> None:
    for kind, name in made:
        store.drop(kind, name)
