"""One run at a time writes to a place: who writes where stands in files of the machine's temporary folder.

Each run has a file there with its process and its places. What a dead process left behind counts for nothing and is
removed by whoever comes next. Runs on other machines that write to the same drive do not see each other.
"""

from __future__ import annotations

import getpass
import json
import os
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bunraku.core.request.json_form import from_json
from bunraku.errors import BunrakuError, FormatError

__all__ = ["alone"]

GUARD = "guard"
GUARD_SECONDS = 5.0
"""A guard that is older was left by a process that died within the milliseconds for which it is held."""


@dataclass(frozen=True)
class _Run:
    """A run that writes.

    Args:
        process: Its id.
        born: When the process began, as the system counts; "" where that is not known.
        files: Files that it writes, absolute.
        folders: Folders that it fills.
    """

    process: int
    born: str
    files: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()

    def meets(self, other: _Run) -> str:
        """A place that both write, "" for none."""
        for one, two in ((self, other), (other, self)):
            for path in (*one.files, *one.folders):
                inside = any(Path(folder) in Path(path).parents for folder in two.folders)
                if inside or path in (*two.files, *two.folders):
                    return path
        return ""

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return _runs(self.process) and _born(self.process) == self.born


@contextmanager
def alone(files: Iterable[Path] = (), folders: Iterable[Path] = ()) -> Iterator[None]:
    """While this lasts, no other run writes to these places.

    Args:
        files: Files that are written.
        folders: Folders that are filled, with all in them.

    Raises:
        FormatError: Another run writes there.
    """
    texts = [tuple(os.path.realpath(path) for path in paths) for paths in (files, folders)]
    own = _Run(os.getpid(), _born(os.getpid()), texts[0], texts[1])
    lock = _place()
    if lock is None:  # a machine without a temporary folder has bigger troubles
        yield
        return
    mark = lock / f"{own.process}-{time.monotonic_ns()}.json"
    with _guarded(lock):
        for file in lock.glob("*.json"):
            other = _read(file)
            if other is None or not other.alive:
                file.unlink(missing_ok=True)
            elif other.process != own.process and (met := own.meets(other)):
                raise FormatError(
                    met,
                    f"another run of Bunraku (process {other.process}) is writing here; wait until it is done, or "
                    "choose another path with -o",
                )
        mark.write_text(
            json.dumps({"process": own.process, "born": own.born, "files": own.files, "folders": own.folders}),
            encoding="utf-8",
        )
    try:
        yield
    finally:
        with suppress(OSError):
            mark.unlink(missing_ok=True)


def _place() -> Path | None:
    """The folder of the files, which only this user may read."""
    try:
        folder = Path(tempfile.gettempdir()) / f"bunraku-runs-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        mine = not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()
        return folder if mine and not folder.is_symlink() and os.access(folder, os.W_OK) else None
    except (OSError, KeyError, ImportError):  # nobody's name is known
        return None


@contextmanager
def _guarded(folder: Path) -> Iterator[None]:
    """While this lasts, no other run looks or writes in the folder."""
    guard, until = folder / GUARD, time.monotonic() + 2 * GUARD_SECONDS
    while True:
        try:
            os.close(os.open(guard, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            break
        except FileExistsError:
            with suppress(OSError):
                if time.time() - guard.stat().st_mtime > GUARD_SECONDS:
                    guard.unlink()
            if time.monotonic() > until:
                break
            time.sleep(0.01)
    try:
        yield
    finally:
        guard.unlink(missing_ok=True)


def _read(file: Path) -> _Run | None:
    try:
        return from_json(_Run, json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError, BunrakuError):
        return None


def _runs(process: int) -> bool:
    """Whether there is a process of this id."""
    if os.name == "nt":
        import ctypes

        kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
        handle = kernel.OpenProcess(0x1000, False, process)
        if handle:
            kernel.CloseHandle(handle)
        return bool(handle)
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True


def _born(process: int) -> str:
    """When a process began, in the system's ticks; "" where the system does not tell."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError, UnicodeDecodeError):
        return ""
