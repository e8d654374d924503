"""A project as one file, `.bunraku`: a ZIP with a character, its takes, and how the page stood."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from bunraku.core.request.json_form import from_json
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import atomic_write, inside, writing
from bunraku.studio.forms import check_asked
from bunraku.studio.opened import Settings
from bunraku.studio.store import Store

__all__ = ["pack_project", "unpack_project"]

VERSION = 1
MOST_UNPACKED = 1 << 30
MOST_ENTRIES = 5000
_FILES = ("mesh.glb", "handles.npz", "bones.glb")
_TAKE_FILES = ("clip.bin", "motion.npz")
_MAY_HAVE = "apparel.npz"
"""Of takes whose apparel is learned."""
_KEPT = ("name", "settings", "axes", "unit", "vertices", "faces", "height", "bounds", "joints", "rig", "physics",
         "apparel", "mmd", "roles", "positions", "used", "ends", "clips", "file")  # fmt: skip


@dataclass(frozen=True)
class _TakeRecord:
    """What a project says of a take; what was asked for it is read by `studio.forms`."""

    script: tuple[object, ...] = ()
    asked: object = None
    how: Literal["animate", "edit", "bend", "dress", "transfer"] = "animate"
    seed: int = 0
    seeds: tuple[int, ...] = ()
    star: bool = False
    title: str = ""
    skin: Literal["handles", "bones"] = "handles"
    fps: float = 20.0
    frames: int = 0
    seconds: float = 0.0
    clip: Literal["clip.bin"] = "clip.bin"
    stiffness: float | None = None


_OF_TAKES = [field.name for field in fields(_TakeRecord)]


def pack_project(store: Store, character: str, view: dict[str, Any], path: Path) -> None:
    """Write a project with a character and its finished takes.

    Raises:
        NotThere: There is no such character.
        FormatError: The file cannot be written.
    """
    record, place = store.get("characters", character), store.place("characters", character)
    takes = [take for take in store.all("takes") if take["character"] == character and take["state"] == "done"]
    about = {
        "version": VERSION,
        "character": {name: record[name] for name in _KEPT if name in record},
        "takes": [{**{name: take[name] for name in _OF_TAKES if name in take}, "was": take["id"]} for take in takes],
        "view": view,
    }
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr(_entry("project.json"), json.dumps(about, ensure_ascii=False, sort_keys=True))
        for name in _FILES:
            if (place / name).is_file():
                out.writestr(_entry(f"character/{name}"), (place / name).read_bytes())
        for source in sorted((place / "source").rglob("*")):
            if source.is_file():
                out.writestr(_entry(f"character/{source.relative_to(place).as_posix()}"), source.read_bytes())
        for take in takes:
            folder = store.place("takes", take["id"])
            for name in (*_TAKE_FILES, *((_MAY_HAVE,) if (folder / _MAY_HAVE).is_file() else ())):
                data = (folder / name).read_bytes()
                out.writestr(_entry(f"takes/{take['id']}/{name}"), data)


def _entry(name: str) -> zipfile.ZipInfo:
    """An entry without the time of day, so that the same project is the same file."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def unpack_project(store: Store, path: Path) -> dict[str, Any]:
    """Add the character and takes of a project to the store: the character's id, and how the page stood.

    Raises:
        FormatError: The file is broken, no project, or too large.
    """
    made: list[tuple[str, str]] = []
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) > MOST_ENTRIES or sum(entry.file_size for entry in entries) > MOST_UNPACKED:
                raise FormatError(path.name, "it unpacks to too much; export its takes and save it anew")
            about = json.loads(archive.read("project.json"))
            if about.get("version") != VERSION:
                raise FormatError(path.name, "it was saved by another version of Bunraku; open it with that one")
            old = about["character"]
            fresh = {name: old[name] for name in _KEPT if name in old}
            from_json(Settings, fresh.get("settings", {}), "settings")
            if inside(path.parent, str(fresh["file"])) is None or not str(fresh["file"]).startswith("source/"):
                raise FormatError(path.name, "its character lies outside of it; save it again")
            character = store.new("characters", {**fresh, "state": "opening", "error": "", "version": 1})
            made.append(("characters", character["id"]))
            place = store.place("characters", character["id"])
            for entry in entries:
                if entry.filename.startswith("character/") and not entry.is_dir():
                    name = entry.filename.removeprefix("character/")
                    target = inside(place, name)
                    if target is None or (name not in _FILES and not name.startswith("source/")):
                        raise FormatError(path.name, "a file in it is to lie outside of its folder; save it again")
                    _copy(archive, entry, target)
            names = {}
            for take in about["takes"]:
                values = {name: take[name] for name in _OF_TAKES if name in take}
                from_json(_TakeRecord, values, "a take")
                check_asked(values.get("how"), values.get("script"), values.get("asked"))
                new = store.new("takes", {"error": "", **values, "character": character["id"], "state": "waiting"})
                made.append(("takes", new["id"]))
                names[str(take["was"])] = new["id"]
                known = f"takes/{take['was']}/{_MAY_HAVE}" in archive.NameToInfo
                for file in (*_TAKE_FILES, *((_MAY_HAVE,) if known else ())):
                    target = store.place("takes", new["id"]) / file
                    _copy(archive, archive.getinfo(f"takes/{take['was']}/{file}"), target)
                store.change("takes", new["id"], state="done")
            store.change("characters", character["id"], state="ready")
            view = about.get("view") if isinstance(about.get("view"), dict) else {}
            return {"character": character["id"], "takes": names, "view": view}
    except FormatError:
        _undo(store, made)
        raise
    except OptionError as error:
        _undo(store, made)
        raise FormatError(path.name, f"{error}; save the project again") from None
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError, RuntimeError, EOFError):
        _undo(store, made)
        raise FormatError(path.name, "it is no project of Bunraku, or broken; save it again") from None


def _undo(store: Store, made: list[tuple[str, str]]) -> None:
    for kind, name in made:
        store.drop(kind, name)


def _copy(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(entry) as source, writing(target), target.open("wb") as out:
        shutil.copyfileobj(source, out, 1 << 20)
