"""What the studio keeps: characters, takes and projects in a folder of the user's, written whole or not at all.

Each is a folder with a record, `record.json`, and the binary files that the worker wrote beside it. Only the server
writes records, and a file that a record names is there before the record. A folder whose record cannot be used is kept
aside. What is given up has its record renamed, which needs no space.
"""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from bunraku.core.files import atomic_write, remove_leftovers, temporary_prefix, writing
from bunraku.core.request import storable
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.studio.records import LARGEST, RECORD, Record, read_record, written

_log = logging.getLogger(__name__)
KINDS = ("characters", "takes", "projects", "jobs", "exports")
ASIDE = "set-aside"
"""The folder of what could not be read."""
GIVEN_UP = "given-up.json"
"""The record of what is given up: it is deleted when the studio starts again, or when the disk is full."""
MOST_TAKES = 2000
_ID = re.compile(r"[0-9a-f]{16}")
_PROBE = 64 << 10
"""Bytes that are written to try the folder: at the start, and after it refused a file."""


class NotThere(BunrakuError):
    """There is no such character, take, project or job."""


def default_folder() -> Path:
    """Where the studio keeps everything unless the user names another folder."""
    base = os.environ.get("XDG_DATA_HOME") or os.path.join(os.path.expanduser("~"), ".local", "share")
    return Path(base) / "bunraku" / "studio"


class Store:
    """The folder.

    Args:
        folder: Made where it is missing; FormatError where that fails. One that cannot be written to is read, and
            `trouble` says so.
    """

    def __init__(self, folder: Path):
        self.folder = folder.resolve()
        self.trouble = ""
        """Why nothing can be kept at the moment, in one sentence."""
        self.troubled: Callable[[str], None] = lambda trouble: None
        """Called when that changes."""
        self.set_aside: list[str] = []
        """What could not be read, one sentence each."""
        if not self.folder.is_dir():
            with writing(self.folder, "folder"):
                self.folder.mkdir(parents=True)
        self._lock = threading.RLock()
        self._records: dict[str, dict[str, Record]] = {kind: {} for kind in KINDS}
        self._unwritten: set[tuple[str, str]] = set()
        remove_leftovers(self.folder)
        self._probe()
        for kind in KINDS:
            home = self.folder / kind
            with suppress(OSError):
                home.mkdir(exist_ok=True)
            for entry in sorted(home.iterdir()) if home.is_dir() else ():
                self._find(kind, entry)
        for name, record in list(self._records["takes"].items()):
            owner = str(record.get("character"))
            if owner not in self._records["characters"] and not (self.folder / ASIDE / f"character-{owner}").is_dir():
                self.drop("takes", name)  # its character was given up
        aside = self.folder / ASIDE
        self.set_aside += [self._aside(entry) for entry in sorted(aside.glob("*")) if entry.is_dir()]

    def _probe(self) -> None:
        try:
            with tempfile.NamedTemporaryFile(prefix=temporary_prefix("probe"), suffix=".tmp", dir=self.folder) as file:
                file.write(bytes(_PROBE))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            self._refused(error)
        else:
            self._refused(None)

    def _refused(self, error: OSError | None) -> None:
        reason = "" if error is None else (
            f"the studio's folder takes nothing more ({(error.strerror or str(error)).lower()}): what there is is "
            "shown, what is made now is gone at the end; free some space, or start it with another --folder"
        )  # fmt: skip
        if reason != self.trouble:
            self.trouble = reason
            if reason:
                _log.warning("%s", reason)
            self.troubled(reason)

    def _find(self, kind: str, folder: Path) -> None:
        if not _ID.fullmatch(folder.name) or not folder.is_dir():
            return
        remove_leftovers(folder)
        path = folder / RECORD
        try:
            if kind == "exports" or (not path.exists() and ((folder / GIVEN_UP).exists() or not any(folder.iterdir()))):
                shutil.rmtree(folder, ignore_errors=True)  # a copy, given up in an earlier run, or never begun
                return
            record, wrong = read_record(kind, path)
        except FileNotFoundError:
            record, wrong = None, "its record is missing"
        except OSError as error:
            record, wrong = None, f"its record cannot be read ({(error.strerror or str(error)).lower()})"
        if record is None:
            self._put_aside(kind, folder, wrong)
        elif record.get("deleted"):  # as earlier versions said it
            shutil.rmtree(folder, ignore_errors=True)
        else:
            self._records[kind][folder.name] = {**record, "id": folder.name}

    def _put_aside(self, kind: str, folder: Path, wrong: str) -> None:
        target = self.folder / ASIDE / f"{kind[:-1]}-{folder.name}"
        try:
            target.parent.mkdir(exist_ok=True)
            os.rename(folder, target)
        except OSError:  # it stays where it is
            target = folder
            self.set_aside.append(self._aside(folder))
        _log.warning("%s: %s; it is kept in %s", folder.name, wrong.partition(";")[0], target)

    def _aside(self, folder: Path) -> str:
        """A sentence about a folder that is kept aside."""
        sources = sorted(path.name for path in (folder / "source").rglob("*") if path.is_file())
        where = folder.relative_to(self.folder).as_posix()
        if sources:
            return f"a character could not be read; its file {sources[0]} is kept in {where}/source: drop it again"
        return f"something could not be read and is kept in {where}; delete that folder if you do not miss it"

    def new(self, kind: str, record: Record) -> Record:
        """Add a thing and give back its record with its id; FormatError where it cannot be written."""
        name = secrets.token_hex(8)
        folder = self.folder / kind / name
        record = storable({**record, "id": name, "created": time.time()})
        try:
            with writing(folder, "folder"):
                folder.mkdir()
            with self._lock:
                self._write(kind, record)
                self._catch_up()
        except FormatError as error:
            self._refused_by(error)
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._records[kind][name] = record
        return record

    def get(self, kind: str, name: str) -> Record:
        """The record of a thing; NotThere where there is none."""
        record = self._records[kind].get(name) if isinstance(name, str) else None
        if record is None:
            raise NotThere(f"there is no such {kind[:-1]} any more; reload the page")
        return record

    def change(self, kind: str, name: str, /, **values: object) -> Record:
        """Change a record and give it back; `deleted` gives a thing up or takes that back, which needs no space.

        NotThere where there is no such thing; FormatError, with nothing changed, where it cannot be written.
        """
        with self._lock:  # the queue's thread and those of requests change the same things
            old = self.get(kind, name)
            record = {**old, **storable(values)}
            if bool(old.get("deleted")) != bool(record.get("deleted")):
                self._give_up(kind, name, bool(record.get("deleted")))
            if values.keys() - {"deleted"}:
                self._write(kind, record)
                self._catch_up()
            self._records[kind][name] = record
            if record.get("deleted") and self.trouble:
                self.make_room()
        return record

    def note(self, kind: str, name: str, /, **values: object) -> Record:
        """Change a record even where the disk refuses it: it is in memory then, and written when the disk takes it;
        NotThere where there is no such thing.
        """
        with self._lock:
            record = {**self.get(kind, name), **storable(values)}
            try:
                self._write(kind, record)
            except FormatError:
                self._unwritten.add((kind, name))
            self._records[kind][name] = record
        return record

    def _give_up(self, kind: str, name: str, gone: bool) -> None:
        names = (RECORD, GIVEN_UP) if gone else (GIVEN_UP, RECORD)
        old, new = (self.folder / kind / name / name_of_folder for name_of_folder in names)
        with writing(old):
            os.rename(old, new)

    def all(self, kind: str) -> list[Record]:
        """All records of a kind that are not given up, oldest first; a take is given up with its character."""
        records = [record for record in list(self._records[kind].values()) if not record.get("deleted")]
        if kind == "takes":
            records = [record for record in records if self._owned(record)]
        return sorted(records, key=lambda record: float(record.get("created", 0)))

    def _owned(self, take: Record) -> bool:
        """Whether the character of a take is there and not given up."""
        owner = self._records["characters"].get(take.get("character"))  # type: ignore[arg-type]
        return owner is not None and not owner.get("deleted")

    def check_takes(self, count: int) -> None:
        """Raise OptionError where so many takes more are too many."""
        if len(self.all("takes")) + count > MOST_TAKES:
            raise OptionError(f"there are {MOST_TAKES:,} takes; delete some that are not needed")

    def drop(self, kind: str, name: str) -> None:
        """Remove a thing with its files, and a character with its takes."""
        if self._records[kind].pop(name, None) is not None:
            shutil.rmtree(self.folder / kind / name, ignore_errors=True)
        if kind == "characters":
            for take in [
                take for take, record in list(self._records["takes"].items()) if record.get("character") == name
            ]:
                self.drop("takes", take)

    def make_room(self) -> bool:
        """Remove what is given up, and copies that were written; whether there was any."""
        finished = [
            (kind, name)
            for kind in KINDS
            for name, record in list(self._records[kind].items())
            if record.get("deleted") or (kind == "exports" and record.get("state") == "done")
        ]
        for kind, name in finished:
            self.drop(kind, name)
        return bool(finished)

    def folder_of(self, kind: str, name: str) -> Path:
        """The folder of a thing; NotThere where there is no such thing."""
        return self.folder / kind / str(self.get(kind, name)["id"])

    def file(self, kind: str, name: str, file: str) -> Path:
        """A file of a thing, whose name never comes from a client; NotThere where it is missing."""
        path = self.folder_of(kind, name) / file
        if not path.is_file():
            raise NotThere(f"this {kind[:-1]} is not finished yet; wait for it, or make it again")
        return path

    def _write(self, kind: str, record: Record) -> None:
        path = self.folder / kind / str(record["id"]) / (GIVEN_UP if record.get("deleted") else RECORD)
        data = written(record)
        if len(data) > LARGEST:
            raise FormatError(path, "the record is too large; delete takes that are not needed")
        try:
            try:
                self._put(path, data)
            except FormatError:
                if not self.make_room():
                    raise
                self._put(path, data)
        except FormatError as error:
            self._refused_by(error)
            raise
        self._unwritten.discard((kind, str(record["id"])))
        if self.trouble:
            self._probe()

    def _catch_up(self) -> None:
        """Write what the disk refused before."""
        for kind, name in sorted(self._unwritten):
            record = self._records[kind].get(name)
            try:
                if record is not None:
                    self._write(kind, record)
            except FormatError:
                return
            self._unwritten.discard((kind, name))

    def _refused_by(self, error: FormatError) -> None:
        if isinstance(error.__context__, OSError):
            self._refused(error.__context__)

    @staticmethod
    def _put(path: Path, data: bytes) -> None:
        with atomic_write(path) as file:
            file.write(data)
