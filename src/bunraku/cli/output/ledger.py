"""What the command line may write over: only what it wrote itself, as it left it.

A ledger, a file of one JSON list a line in the folder of the results, tells of each file what it was made of, and how
large it was and when, once it was whole. A batch leaves out files that were made of the same inputs with the same
options by the same version, does again what it had only begun, and refuses to touch anything else. A single file may
also say itself that Bunraku wrote it, as GLB and VRMA do.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bunraku.errors import FormatError
from bunraku.formats.files import sweep

__all__ = ["begin", "check_free", "fingerprint", "note", "note_written", "still_to_do"]

LEDGER = ".bunraku-ledger.jsonl"
_MOST_JSON = 64 << 20  # of a GLB whose maker is looked up [bytes]


def fingerprint(inputs: Iterable[Path], *facts: Any) -> str:
    """What a result is made of, as a short text: its inputs by place, size and time, the facts, and the version.

    Args:
        inputs: Files, or folders of files.
        *facts: All options that change the result, of types that JSON knows.
    """
    from bunraku import __version__

    seen: list[Any] = [__version__, os.environ.get("BUNRAKU_WEIGHTS", ""), facts]
    for path in inputs:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        seen += [[str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns] for file in files if file.exists()]
    return hashlib.sha256(json.dumps(seen).encode()).hexdigest()[:32]


def still_to_do(marks: Mapping[Path, str], overwrite: bool = False) -> list[Path]:
    """Which results are still to be made.

    Args:
        marks: The fingerprint of each result, a file or a folder of files; all lie in one folder.
        overwrite: Make those too whose place is taken by something else.

    Raises:
        FormatError: Something else is in the place of a result.
    """
    todo: list[Path] = []
    taken: list[Path] = []
    folder = next(iter(marks)).parent if marks else None
    known = {} if folder is None else _entries(folder)
    if folder is not None:
        sweep(folder)
    for path, mark in marks.items():
        made, state = known.get(path.name, ("", None))
        here = _state(path)
        if here is not None and made == mark and state == here:
            continue
        if here is not None and not (made == mark and state is None):
            taken.append(path)
        todo.append(path)
    if taken and not overwrite:
        _refuse(taken)
    return todo


def begin(marks: Mapping[Path, str]) -> None:
    """Note that results are being made; should the run be stopped, the next one may do them again."""
    _append({path: (mark, None) for path, mark in marks.items()})


def note(path: Path, mark: str) -> None:
    """Note that a result is whole."""
    _append({path: (mark, _state(path))})


def check_free(paths: Iterable[Path], overwrite: bool, ours: bool = True) -> None:
    """Make sure that single results lose nothing: their places are free, or hold what Bunraku wrote. What killed runs
    left half-done beside them goes.

    Args:
        paths: Files, or folders of files.
        overwrite: Whether anything may be written over.
        ours: Whether what Bunraku wrote may be.

    Raises:
        FormatError: Something else is in the place of a result.
    """
    paths = list(paths)
    for folder in {path.parent for path in paths}:
        sweep(folder)
    taken = [path for path in paths if not overwrite and _state(path) is not None and not (ours and _ours(path))]
    if taken:
        _refuse(taken)


def note_written(paths: Iterable[Path]) -> None:
    """Note single results, but for those that say themselves who wrote them."""
    for path in paths:
        if not _says_bunraku(path):
            note(path, "single")


def _refuse(taken: list[Path]) -> None:
    more = f", and so are {len(taken) - 1} more" if len(taken) > 1 else ""
    raise FormatError(
        taken[0],
        f"this is there already{more}, and not what this command left with these inputs and options; choose another "
        "place with -o, or replace it with --overwrite",
    )


def _ours(path: Path) -> bool:
    return _says_bunraku(path) or _entries(path.parent).get(path.name, ("", None))[1] == _state(path)


def _state(path: Path) -> list[int] | None:
    """Sizes and latest change of a file, or of all files of a folder; None where there is nothing."""
    if not path.exists():
        return [path.lstat().st_mtime_ns] if path.is_symlink() else None
    files = [path] if path.is_file() else sorted(path.iterdir())
    if not files:
        return None
    stats = [file.stat() for file in files if file.exists()]
    return [len(files), sum(stat.st_size for stat in stats), max((stat.st_mtime_ns for stat in stats), default=0)]


def _says_bunraku(path: Path) -> bool:
    """Whether a GLB or VRMA names Bunraku as its generator."""
    try:
        with path.open("rb") as file:
            start = file.read(20)
            length = int.from_bytes(start[12:16], "little")
            if start[:4] != b"glTF" or start[16:20] != b"JSON" or length > _MOST_JSON:
                return False
            tree = json.loads(file.read(length))
        return bool(tree["asset"]["generator"] == "bunraku")
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return False


def _entries(folder: Path) -> dict[str, tuple[str, list[int] | None]]:
    """What the ledger of a folder says last of each name; lines that a stopped run left in half do not count."""
    try:
        lines = (folder / LEDGER).read_text(encoding="utf-8", errors="replace").splitlines()
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
        lines = [
            json.dumps([path.name, mark, state]) + "\n"
            for path, (mark, state) in entries.items()
            if path.parent == folder
        ]
        try:
            with (folder / LEDGER).open("a", encoding="utf-8") as file:
                file.write("\n" * (file.tell() > 0 and not _ends_whole(folder / LEDGER)) + "".join(lines))
        except OSError as error:
            raise FormatError(
                folder / LEDGER, f"the list of results cannot be written ({error.strerror or error}); free some space"
            ) from None


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
