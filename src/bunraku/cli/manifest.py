"""What the command line may overwrite: only files that it wrote itself, one process at a time."""

from __future__ import annotations

import getpass
import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bunraku.core.files import remove_leftovers
from bunraku.errors import FormatError

SINGLE = "single"
"""The mark of results that no batch made."""
MANIFEST = ".bunraku-ledger.jsonl"
_MOST_JSON = 64 << 20  # of a GLB whose maker is looked up [bytes]


def fingerprint(inputs: Iterable[Path], *facts: Any) -> str:
    """A short text that changes with the path, size or time of an input, a file or a folder of files, with the version,
    and with the facts, all options that change the result, of types that JSON has.
    """
    from bunraku import __version__

    seen: list[Any] = [__version__, os.environ.get("BUNRAKU_WEIGHTS", ""), facts]
    for path in inputs:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        seen += [[str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns] for file in files if file.exists()]
    return hashlib.sha256(json.dumps(seen).encode()).hexdigest()[:32]


def unfinished(marks: Mapping[Path, str], overwrite: bool = False) -> list[Path]:
    """Which results of one folder, each a file or a folder of files with its fingerprint, are still to be made.
    FormatError where something else lies in the path of one, unless that may be overwritten.
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
    """Raise FormatError where single results, files or folders of files, would replace something else than Bunraku
    wrote, or even that where it is not `ours`; not with `overwrite`. What killed runs left half-done beside them is
    removed.
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


MOST_LOCKS = 200
"""Files that are locked one by one; the folders of more are locked, since a process has about 1,000 open files."""
_HELD: set[str] = set()
"""Paths that this process has locked."""


@contextmanager
def exclusive_output(files: Iterable[Path] = (), folders: Iterable[Path] = ()) -> Iterator[None]:
    """While this lasts, no other process writes to these files, nor into these folders; FormatError where another one
    writes there.

    What is written is locked for this process alone, and all folders above it for this process and others that write
    elsewhere in them. The system gives back the locks of a process that dies.
    """
    written = {os.path.realpath(path) for path in files}
    written = written if len(written) <= MOST_LOCKS else {os.path.dirname(path) for path in written}
    written |= {os.path.realpath(path) for path in folders}
    above = {str(folder) for path in written for folder in Path(path).parents} - written
    home = _lock_folder()
    if home is None:
        yield
        return
    locks: dict[str, tuple[Path, int]] = {}
    try:
        for path in sorted((written | above) - _HELD):
            file = home / hashlib.sha256(path.encode()).hexdigest()[:32]
            locks[path] = file, _locked(file, path, path in written)
        _HELD.update(locks)
        yield
    finally:
        _HELD.difference_update(locks)
        for file, lock in locks.values():
            _unlock(file, lock)


def _lock_folder() -> Path | None:
    """The folder of the locks, which only this user may read; None where the system has no such locks."""
    try:
        import fcntl  # noqa: F401 -- not on Windows

        folder = Path(tempfile.gettempdir()) / f"bunraku-runs-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        mine = folder.stat().st_uid == os.getuid()
        return folder if mine and not folder.is_symlink() and os.access(folder, os.W_OK) else None
    except (OSError, KeyError, ImportError):  # the user has no name
        return None


def _locked(file: Path, path: str, alone: bool) -> int:
    """The open file that locks a path, for this process alone or for others too."""
    import fcntl

    while True:
        lock = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(lock, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except OSError:
            holder = os.read(lock, 20).decode("ascii", "replace").strip()
            os.close(lock)
            raise FormatError(
                path,
                f"another run of Bunraku (process {holder}) is writing here; wait until it is done, or choose another "
                "path with -o",
            ) from None
        with suppress(FileNotFoundError):  # where the process that held it has just removed it
            if os.path.samestat(os.fstat(lock), file.stat()):
                os.pwrite(lock, b"%-20d" % os.getpid(), 0)
                return lock
        os.close(lock)


def _unlock(file: Path, lock: int) -> None:
    """Give a lock back, and remove its file where no other process holds it."""
    import fcntl

    with suppress(OSError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        file.unlink()
    os.close(lock)
