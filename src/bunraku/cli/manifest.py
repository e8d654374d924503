"""What the command line may overwrite: only files that it wrote itself, one process at a time."""

from __future__ import annotations

import getpass
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.core.files import is_alive, remove_leftovers
from bunraku.core.request import from_json, to_json
from bunraku.errors import BunrakuError, FormatError

SINGLE = "single"
"""The mark of results that no batch made."""
MANIFEST = ".bunraku-ledger.jsonl"
_MOST_JSON = 64 << 20  # of a GLB whose maker is looked up [bytes]


def fingerprint(inputs: Iterable[Path], *facts: Any) -> str:
    """A short text that changes with the path, size or time of an input, with the facts, and with the version.

    Args:
        inputs: Files, or folders of files.
        *facts: All options that change the result, of types that JSON has.
    """
    from bunraku import __version__

    seen: list[Any] = [__version__, os.environ.get("BUNRAKU_WEIGHTS", ""), facts]
    for path in inputs:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        seen += [[str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns] for file in files if file.exists()]
    return hashlib.sha256(json.dumps(seen).encode()).hexdigest()[:32]


def unfinished(marks: Mapping[Path, str], overwrite: bool = False) -> list[Path]:
    """Which results are still to be made.

    Args:
        marks: The fingerprint of each result, a file or a folder of files; all lie in one folder.
        overwrite: Also make those in whose path something else lies.

    Raises:
        FormatError: Something else lies in the path of a result.
    """
    if not marks:
        return []
    folder = next(iter(marks)).parent
    entries = _entries(folder)
    remove_leftovers(folder)
    todo: list[Path] = []
    taken: list[Path] = []
    for path, mark in marks.items():
        fingerprint, state = entries.get(path.name, ("", None))
        here = _state(path)
        if here is not None and fingerprint == mark and state == here:
            continue
        if here is not None and not (fingerprint == mark and state is None):
            taken.append(path)
        todo.append(path)
    if taken and not overwrite:
        _refuse(taken)
    return todo


def note_begun(marks: Mapping[Path, str]) -> None:
    """Note that results are being made; should the run be stopped, the next one may do them again."""
    _append({path: (mark, None) for path, mark in marks.items()})


def note_done(path: Path, mark: str) -> None:
    """Note that a result is whole."""
    _append({path: (mark, _state(path))})


def check_free(paths: Iterable[Path], overwrite: bool, ours: bool = True) -> None:
    """Make sure that single results replace nothing but what Bunraku wrote. What killed runs left half-done beside them
    is removed.

    Args:
        paths: Files, or folders of files.
        overwrite: Whether anything may be replaced.
        ours: Whether what Bunraku wrote may be.

    Raises:
        FormatError: Something else lies in the path of a result.
    """
    paths = list(paths)
    for folder in {path.parent for path in paths}:
        remove_leftovers(folder)
    taken = [path for path in paths if not overwrite and _state(path) is not None and not (ours and _ours(path))]
    if taken:
        _refuse(taken)


def note_written(paths: Iterable[Path]) -> None:
    """Note single results, except those that name Bunraku as their generator."""
    for path in paths:
        if _own_tree(path) is None:
            note_done(path, SINGLE)


def is_result(path: Path) -> bool:
    """Whether a file is an animation that Bunraku wrote."""
    tree = _own_tree(path)
    return (
        bool(tree.get("animations"))
        if tree is not None
        else _entries(path.parent).get(path.name) == (SINGLE, _state(path))
    )


def _refuse(taken: list[Path]) -> None:
    more = f", and so are {len(taken) - 1} more" if len(taken) > 1 else ""
    raise FormatError(
        taken[0],
        f"this is there already{more}, and not what this command left with these inputs and options; choose another "
        "path with -o, or replace it with --overwrite",
    )


def _ours(path: Path) -> bool:
    return _own_tree(path) is not None or _entries(path.parent).get(path.name, ("", None))[1] == _state(path)


def _state(path: Path) -> list[int] | None:
    """Sizes and latest change of a file, or of all files of a folder; None where there is nothing."""
    if not path.exists():
        return [path.lstat().st_mtime_ns] if path.is_symlink() else None
    files = [path] if path.is_file() else sorted(path.iterdir())
    if not files:
        return None
    stats = [file.stat() for file in files if file.exists()]
    return [len(files), sum(stat.st_size for stat in stats), max((stat.st_mtime_ns for stat in stats), default=0)]


def _own_tree(path: Path) -> dict[str, Any] | None:
    """The JSON of a GLB or VRMA that names Bunraku as its generator; None of other files."""
    try:
        with path.open("rb") as file:
            start = file.read(20)
            length = int.from_bytes(start[12:16], "little")
            if start[:4] != b"glTF" or start[16:20] != b"JSON" or length > _MOST_JSON:
                return None
            tree: dict[str, Any] = json.loads(file.read(length))
        return tree if tree["asset"]["generator"] == "bunraku" else None
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return None


def _entries(folder: Path) -> dict[str, tuple[str, list[int] | None]]:
    """The last entry of the manifest for each name; lines that a stopped run left in half do not count."""
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    out: dict[str, tuple[str, list[int] | None]] = {}
    for line in lines:
        try:
            name, mark, state = json.loads(line)
        except (ValueError, TypeError, RecursionError):
            continue
        if isinstance(name, str) and isinstance(mark, str):
            out[name] = mark, state if isinstance(state, list) else None
    return out


def _append(entries: Mapping[Path, tuple[str, list[int] | None]]) -> None:
    for folder in dict.fromkeys(path.parent for path in entries):
        here = {path.name: entry for path, entry in entries.items() if path.parent == folder}
        lines = [json.dumps([name, *entry]) + "\n" for name, entry in here.items()]
        try:
            with (folder / MANIFEST).open("a", encoding="utf-8") as file:
                file.write("\n" * (file.tell() > 0 and not _ends_whole(folder / MANIFEST)) + "".join(lines))
        except OSError as error:
            raise FormatError(
                folder / MANIFEST, f"the list of results cannot be written ({error.strerror or error}); free some space"
            ) from None


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


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
        """A path that both write, "" for none."""
        for run, beside in ((self, other), (other, self)):
            for path in (*run.files, *run.folders):
                inside = any(Path(folder) in Path(path).parents for folder in beside.folders)
                if inside or path in (*beside.files, *beside.folders):
                    return path
        return ""

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return is_alive(self.process) and _born(self.process) == self.born


@contextmanager
def exclusive_output(files: Iterable[Path] = (), folders: Iterable[Path] = ()) -> Iterator[None]:
    """While this lasts, no other run writes to these files, nor into these folders; FormatError where another run
    writes there.
    """
    written, filled = (tuple(os.path.realpath(path) for path in paths) for paths in (files, folders))
    run = _Run(os.getpid(), _born(os.getpid()), written, filled)
    lock = _lock_folder()
    if lock is None:  # a machine without a temporary folder has bigger troubles
        yield
        return
    mark = lock / f"{run.process}-{time.monotonic_ns()}.json"
    with _guarded(lock):
        for file in lock.glob("*.json"):
            other = _read(file)
            if other is None or not other.alive:
                file.unlink(missing_ok=True)
            elif other.process != run.process and (met := run.meets(other)):
                raise FormatError(
                    met,
                    f"another run of Bunraku (process {other.process}) is writing here; wait until it is done, or "
                    "choose another path with -o",
                )
        mark.write_text(json.dumps(to_json(run)), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            mark.unlink(missing_ok=True)


def _lock_folder() -> Path | None:
    """The folder of the runs' files, which only this user may read."""
    try:
        folder = Path(tempfile.gettempdir()) / f"bunraku-runs-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        mine = not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()
        return folder if mine and not folder.is_symlink() and os.access(folder, os.W_OK) else None
    except (OSError, KeyError, ImportError):  # the user has no name
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


def _born(process: int) -> str:
    """When a process began, in the system's ticks; "" where the system does not say."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError, UnicodeDecodeError):
        return ""
