"""ZIP files that nobody vouches for: their directory is measured before it is read, and each entry within a bound."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bunraku.errors import FormatError
from bunraku.formats.files import writing

__all__ = ["copy_entry", "open_archive", "read_entry"]

_END = struct.Struct("<4s4H2LH")
_LARGEST_ENTRY = 600
"""Bytes that an entry's line of the directory has on average, at the most."""


@contextmanager
def open_archive(path: Path, entries: int, size: int) -> Iterator[zipfile.ZipFile]:
    """The archive of a file.

    Args:
        path: The file.
        entries: How many entries it may have.
        size: Bytes to which it may unpack.

    Raises:
        FormatError: It is broken, has a password, is packed in a rare way, or is too large; or what is done with it in
            the block finds it so.
    """
    try:
        _check_directory(path, entries)
        with zipfile.ZipFile(path) as archive:
            found = archive.infolist()
            if len(found) > entries or sum(entry.file_size for entry in found) > size:
                raise FormatError(
                    path.name, f"it unpacks to too much, at most {size >> 20} MiB in {entries:,} files are taken"
                )
            if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in found):
                raise FormatError(path.name, "it is packed in a rare way; pack it again as an ordinary ZIP")
            yield archive
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, zlib.error):
        raise FormatError(path.name, "the ZIP is broken or has a password; pack or save it again") from None


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
    """The bytes of an entry, at most `most` and one.

    Raises:
        KeyError: There is none.
    """
    with archive.open(name) as source:
        return source.read(most + 1)


def copy_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Write an entry to a file, and no more of it than it says that it has.

    Raises:
        FormatError: The file cannot be written, or the entry has more.
    """
    left = entry.file_size
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(entry) as source, writing(target), target.open("wb") as out:
        while chunk := source.read(1 << 20):
            left -= len(chunk)
            if left < 0:
                raise FormatError(target.name, "it unpacks to more than it says; pack it again")
            out.write(chunk)
