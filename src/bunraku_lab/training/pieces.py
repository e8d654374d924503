"""A large file as pieces that a narrow way lets through, and joined again.

Each piece begins with one line of JSON: the file's name, which piece it is of how many, the file's size and SHA-256.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import MAX_BYTES, atomic_write, check_input

__all__ = ["SUFFIX", "join_pieces", "split_file"]

SUFFIX = ".piece"
_LINE = 1024
"""Longest first line; a piece leaves so much room for it."""
_CHUNK = 1 << 20


@dataclass(frozen=True)
class _Piece:
    """What the first line of a piece says, where the piece lies, and where its bytes start."""

    file: str
    piece: int
    pieces: int
    bytes: int
    sha256: str
    path: Path
    start: int


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def split_file(path: Path, folder: Path, most: int = 16 << 20) -> list[Path]:
    """Write a file as pieces "name.0.piece", "name.1.piece", ... and return them; older ones of it go.

    Args:
        path: The file; it stays.
        folder: To write to, made when it is not there.
        most: Largest piece [bytes].

    Raises:
        OptionError: A piece would hold nothing.
        FormatError: The file is missing or too large, or a piece cannot be written.
    """
    room = most - _LINE
    if room < 1:
        raise OptionError(f"a piece needs more than {_LINE} bytes, not {most}")
    size = check_input(path)
    count = -(-size // room)
    head = {"file": path.name, "pieces": count, "bytes": size, "sha256": _digest(path)}
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{path.name}.*{SUFFIX}"):
        old.unlink()
    written = []
    with path.open("rb") as source:
        for number in range(count):
            target = folder / f"{path.name}.{number}{SUFFIX}"
            with atomic_write(target) as file:
                file.write(json.dumps(head | {"piece": number}).encode() + b"\n")
                left = room
                while left and (part := source.read(min(left, _CHUNK))):
                    file.write(part)
                    left -= len(part)
            written.append(target)
    return written


def _head(path: Path) -> _Piece:
    try:
        with path.open("rb") as file:
            line = file.readline(_LINE)
        head = json.loads(line)
        name, numbers = head["file"], [head[key] for key in ("piece", "pieces", "bytes")]
        plain = isinstance(name, str) and name == Path(name).name and not name.startswith(".") and "\\" not in name
        if not plain or not line.endswith(b"\n") or not all(type(value) is int and value >= 0 for value in numbers):
            raise ValueError("its first line is another one")
        piece, pieces, size = numbers
        return _Piece(name, piece, pieces, size, str(head["sha256"]), path, len(line))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"this is no piece of a file ({error}); copy it again") from error


def join_pieces(folder: Path, output: Path) -> list[Path]:
    """Join all files whose pieces lie in a folder, and return them.

    Args:
        folder: With files "*.piece".
        output: Folder to write the files to, made when it is not there.

    Raises:
        FormatError: A piece is missing, damaged, or of another file than its fellows; nothing of that file is written.
    """
    files: dict[str, list[_Piece]] = {}
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        head = _head(path)
        files.setdefault(head.file, []).append(head)
    if not files:
        raise FormatError(folder, f"there is no piece of a file (*{SUFFIX}) here; name the folder that they came to")
    output.mkdir(parents=True, exist_ok=True)
    return [_join(name, sorted(heads, key=lambda head: head.piece), output / name) for name, heads in files.items()]


def _join(name: str, heads: list[_Piece], target: Path) -> Path:
    folder = heads[0].path.parent
    if len({(head.pieces, head.bytes, head.sha256) for head in heads}) > 1:
        raise FormatError(folder, f"the pieces of {name} are of different files; copy all of one run")
    lacking = sorted(set(range(min(heads[0].pieces, 1 << 16))) - {head.piece for head in heads})
    if lacking:
        raise FormatError(folder, f"piece {lacking[0]} of {name} is missing; copy it again")
    held = sum(head.path.stat().st_size - head.start for head in heads)
    if len(heads) != heads[0].pieces or held != heads[0].bytes or held > MAX_BYTES:
        raise FormatError(folder, f"the pieces of {name} do not add up to its size; copy them again")
    found = hashlib.sha256()
    with atomic_write(target) as file:
        for head in heads:
            with head.path.open("rb") as source:
                source.seek(head.start)
                while part := source.read(_CHUNK):
                    found.update(part)
                    file.write(part)
        if found.hexdigest() != heads[0].sha256:
            raise FormatError(folder, f"the joined {name} is not what was split; copy its pieces again")
    return target
