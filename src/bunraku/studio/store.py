"""What the studio keeps: characters, takes and projects in a folder of the user's, written whole or not at all.

A thing is a folder with a record, `record.json`, and the binary files that the worker wrote beside it. Only the
server writes records, so nothing is written twice at once; a file that a record speaks of is there before the record.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write, sweep, writing

__all__ = ["KINDS", "NotThere", "Store", "default_folder"]

KINDS = ("characters", "takes", "projects", "jobs", "exports")
_ID = re.compile(r"[0-9a-f]{16}")
LARGEST = 4 << 20
"""Bytes of a record."""

Record = dict[str, Any]


class NotThere(BunrakuError):
    """There is no such character, take, project or job."""


def default_folder() -> Path:
    """Where the studio keeps its things unless the user names another place."""
    import os

    base = os.environ.get("XDG_DATA_HOME") or os.path.join(os.path.expanduser("~"), ".local", "share")
    return Path(base) / "bunraku" / "studio"


class Store:
    """The folder.

    Args:
        folder: Made where it is not there.

    Raises:
        FormatError: It cannot be made or written to.
    """

    def __init__(self, folder: Path):
        self.folder = folder.resolve()
        with writing(self.folder, "folder"):
            for kind in KINDS:
                (self.folder / kind).mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._records: dict[str, dict[str, Record]] = {kind: {} for kind in KINDS}
        for kind in KINDS:
            for place in sorted((self.folder / kind).iterdir()):
                self._find(kind, place)

    def _find(self, kind: str, place: Path) -> None:
        if not _ID.fullmatch(place.name) or not place.is_dir():
            return
        sweep(place)
        try:
            path = place / "record.json"
            if path.stat().st_size > LARGEST:
                return
            record = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            record = None
        if not isinstance(record, dict) or record.get("deleted") or kind == "exports":
            shutil.rmtree(place, ignore_errors=True)  # never finished, or given up in an earlier run
            return
        self._records[kind][place.name] = {**record, "id": place.name}

    def new(self, kind: str, record: Record) -> Record:
        """Add a thing and give back its record with its id.

        Raises:
            FormatError: It cannot be written.
        """
        name = secrets.token_hex(8)
        place = self.folder / kind / name
        with writing(place, "folder"):
            place.mkdir()
        record = {**record, "id": name, "created": time.time()}
        try:
            self._write(kind, record)
        except FormatError:
            shutil.rmtree(place, ignore_errors=True)
            raise
        self._records[kind][name] = record
        return record

    def get(self, kind: str, name: str) -> Record:
        """The record of a thing.

        Raises:
            NotThere: There is none.
        """
        record = self._records[kind].get(name) if isinstance(name, str) else None
        if record is None:
            raise NotThere(f"there is no such {kind[:-1]} any more; reload the page")
        return record

    def change(self, kind: str, name: str, /, **values: Any) -> Record:
        """Change a record and give it back.

        Raises:
            NotThere: There is no such thing.
            FormatError: It cannot be written; then nothing has changed.
        """
        with self._lock:  # the queue's thread and those of requests change the same things
            record = {**self.get(kind, name), **values}
            self._write(kind, record)
            self._records[kind][name] = record
        return record

    def all(self, kind: str) -> list[Record]:
        """All records of a kind that are not given up, oldest first."""
        found = [record for record in list(self._records[kind].values()) if not record.get("deleted")]
        return sorted(found, key=lambda record: float(record.get("created", 0)))

    def drop(self, kind: str, name: str) -> None:
        """Remove a thing with its files."""
        if self._records[kind].pop(name, None) is not None:
            shutil.rmtree(self.folder / kind / name, ignore_errors=True)

    def place(self, kind: str, name: str) -> Path:
        """The folder of a thing.

        Raises:
            NotThere: There is no such thing.
        """
        return self.folder / kind / str(self.get(kind, name)["id"])

    def file(self, kind: str, name: str, file: str) -> Path:
        """A file of a thing; its name comes from the program and never from a client.

        Raises:
            NotThere: There is no such thing, or it has no such file yet.
        """
        path = self.place(kind, name) / file
        if not path.is_file():
            raise NotThere(f"this {kind[:-1]} is not finished yet; wait for it, or make it again")
        return path

    def _write(self, kind: str, record: Record) -> None:
        path = self.folder / kind / str(record["id"]) / "record.json"
        data = json.dumps(record, ensure_ascii=False, allow_nan=False).encode()
        if len(data) > LARGEST:
            raise FormatError(path, "the record is too large; delete takes that are not needed")
        with atomic_write(path) as file:
            file.write(data)

    def used(self) -> int:
        """Bytes of all files."""
        total = 0
        for path in self.folder.rglob("*"):
            with suppress(OSError):
                total += path.stat().st_size
        return total
