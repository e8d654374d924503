"""Files that come from a page: streamed to disk within a bound, under a name of ours; ZIPs opened within bounds."""

from __future__ import annotations

import re
import zipfile
from contextlib import suppress
from pathlib import Path, PurePosixPath

from starlette.requests import ClientDisconnect, Request

from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.archives import copy_entry, open_archive
from bunraku.formats.files import inside, writing
from bunraku.io.table import FORMATS

__all__ = ["CHARACTERS", "MOST_BYTES", "MOTIONS", "PROJECTS", "TooLarge", "plain_name", "receive", "unpack"]

MOST_BYTES = 200 << 20
"""Bytes of an upload."""
MOST_REFUSED = 1 << 30
"""Bytes of what is refused that are read, and not kept, so that who sends them hears why."""
MOST_UNPACKED = 600 << 20
MOST_ENTRIES = 2000
CHARACTERS = tuple(suffix for one in FORMATS if one.character for suffix in one.suffixes)
"""Suffixes of what becomes a character."""
MOTIONS = (".bvh", ".vmd", ".vrma", ".npz", ".npy")
"""Suffixes of what is a motion and nothing else."""
PROJECTS = (".bunraku",)
_BESIDE = (".png", ".jpg", ".jpeg", ".bmp", ".tga", ".dds", ".webp", ".sph", ".spa", ".bin", ".mtl", *CHARACTERS)


class TooLarge(BunrakuError):
    """More bytes than are taken."""


def plain_name(name: str) -> tuple[str, str]:
    """A title and a suffix of a client's file name, without its folders; the suffix is lower case."""
    path = PurePosixPath(name.replace("\\", "/"))
    title = re.sub(r"[^\w .()-]+", " ", path.stem).strip(" .")[:80] or "character"
    suffix = path.suffix.lower()
    return title, suffix if re.fullmatch(r"\.[a-z0-9]{1,8}", suffix) else ""


async def receive(request: Request, path: Path, most: int | None = None) -> int:
    """Write the body of a request to a file and return its size; a file that did not come whole is removed.

    Raises:
        TooLarge: It has more bytes than are taken.
        FormatError: The connection broke, there was nothing, or it cannot be written.
    """
    most = MOST_BYTES if most is None else most
    declared = request.headers.get("content-length", "")
    size, whole, chunks = 0, False, request.stream()
    try:
        if declared.isdecimal() and int(declared) > most:
            raise TooLarge(
                f"{path.name}: {int(declared) >> 20} MiB are too many, at most {most >> 20} are taken; simplify it"
            )
        with writing(path), path.open("wb") as file:
            async for chunk in chunks:
                size += len(chunk)
                if size > most:
                    raise TooLarge(f"{path.name}: more than {most >> 20} MiB are not taken; simplify it")
                file.write(chunk)
        if not size:
            raise FormatError(path.name, "the file is empty; export it again")
        if declared.isdecimal() and size != int(declared):
            raise FormatError(path.name, "it did not come whole; drop it again")
        whole = True
    except ClientDisconnect:
        raise FormatError(path.name, "it did not come whole; drop it again") from None
    finally:
        if not whole:
            path.unlink(missing_ok=True)
            with suppress(ClientDisconnect):  # who still sends would not hear the answer
                async for chunk in chunks:
                    size += len(chunk)
                    if size > MOST_REFUSED:
                        break
    return size


def unpack(archive: Path, folder: Path) -> str:
    """Unpack the character of a ZIP with what lies beside it, and give back its file, relative to the folder.

    Raises:
        FormatError: The ZIP is broken, unpacks to too much, names a place outside, or holds no character.
    """
    found: list[str] = []
    with open_archive(archive, MOST_ENTRIES, MOST_UNPACKED) as opened:
        for entry in opened.infolist():
            if entry.is_dir():
                continue
            target = inside(folder, _decoded(entry))
            if target is None:
                raise FormatError(archive.name, "a file in it is to lie outside of its folder; pack it again")
            if target.suffix.lower() not in _BESIDE:
                continue
            copy_entry(opened, entry, target)
            if target.suffix.lower() in CHARACTERS:
                found.append(target.relative_to(folder.resolve()).as_posix())
    if not found:
        raise FormatError(archive.name, f"there is no character in it; characters are {', '.join(CHARACTERS)}")
    return min(found, key=lambda name: (name.count("/"), CHARACTERS.index(Path(name).suffix.lower()), name))


def _decoded(entry: zipfile.ZipInfo) -> str:
    """The name of an entry; ZIPs of MMD models are packed in Japan, whose names are in Shift JIS."""
    if entry.flag_bits & 0x800:
        return entry.filename
    try:
        return entry.filename.encode("cp437").decode("shift_jis")
    except UnicodeError:
        return entry.filename
