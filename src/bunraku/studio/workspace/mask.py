"""Which vertices of a character are hair and clothes, as the page shows and paints it.

What was painted is a file beside the character's own, `girl.apparel.npy` for `girl.glb`, which all that moves apparel
reads (`apparel.artist_mask`). What is found without it is kept in `WORN`, with the vertices of the mesh that the page
draws.
"""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.errors import FormatError, OptionError
from bunraku.formats.arrays.npy import read_npy
from bunraku.formats.files import atomic_write, read_bounded
from bunraku.formats.gltf.write import document_of

__all__ = ["WORN", "clean_mask", "found_mask", "paint", "painted_file", "save_worn", "shown_mask"]

WORN = "worn.bin"
"""What is found of a character, beside its mesh."""
_MAGIC = b"BNRM"


def save_worn(character: Character, found: np.ndarray | None, path: Path) -> None:
    """Write what was found, and which vertices the page draws.

    `BNRM`, the length of a JSON header padded to four bytes, the header (`vertices`, and `parts`: mesh, primitive,
    rows), a bit for each vertex of the character, lowest first, padded to four bytes, and for each primitive the vertex
    of the character that each of its rows is, uint32.

    Args:
        character: The character.
        found: Vertices that are apparel, shape (V,), bool; None where nobody could look.
        path: The file.

    Raises:
        FormatError: It cannot be written.
    """
    source = document_of(character)
    parts: list[dict[str, int]] = []
    rows: list[np.ndarray] = []
    start, mesh = 0, 0
    for part in source.parts:
        own: dict[int, np.ndarray] = {}
        for group in part.groups:
            own |= dict.fromkeys(group.primitives, source.index[start : start + len(group.vertices)])
            start += len(group.vertices)
        if not any(len(index) for index in own.values()):
            continue
        for primitive, member in enumerate(sorted(own)):
            parts.append({"mesh": mesh, "primitive": primitive, "rows": len(own[member])})
            rows.append(own[member].astype("<u4"))
        mesh += 1
    count = len(character.vertices)
    words = json.dumps({"vertices": count, "parts": parts}).encode()
    words += b" " * (-len(words) % 4)
    bits = packed_bits(np.zeros(count, bool) if found is None else found)
    with atomic_write(path) as file:
        file.write(b"".join([_MAGIC, struct.pack("<I", len(words)), words, bits, *(row.tobytes() for row in rows)]))


def packed_bits(mask: np.ndarray) -> bytes:
    """A bit for each entry, lowest first, padded to four bytes."""
    bits = np.packbits(mask, bitorder="little").tobytes()
    return bits + b"\0" * (-len(bits) % 4)


def shown_mask(worn: Path, painted: Path) -> bytes:
    """What the page gets: the file of `save_worn`, with what was painted in the place of what was found.

    Args:
        worn: The file of `save_worn`.
        painted: The file that was painted, if it is there.

    Raises:
        FormatError: One of them is broken.
    """
    data = read_bounded(worn)
    start, count = _head(worn, data)
    if not painted.is_file():
        return data
    mask = read_npy(painted, read_bounded(painted))
    if mask.shape != (count,):
        raise FormatError(painted.name, f"it is no mask of {count:,} vertices; paint it again")
    bits = packed_bits(mask > 0.5)
    return data[:start] + bits + data[start + len(bits) :]


def found_mask(worn: Path) -> np.ndarray:
    """What was found, shape (V,), bool.

    Raises:
        FormatError: The file is broken.
    """
    data = read_bounded(worn)
    start, count = _head(worn, data)
    return np.unpackbits(np.frombuffer(data[start:], np.uint8), count=count, bitorder="little").astype(bool)


def _head(worn: Path, data: bytes) -> tuple[int, int]:
    """Where the bits begin, and how many there are."""
    try:
        length = struct.unpack("<I", data[4:8])[0]
        header: dict[str, Any] = json.loads(data[8 : 8 + length])
        count = int(header["vertices"])
    except (ValueError, KeyError, TypeError, struct.error):
        raise FormatError(worn.name, "it is broken; open the character again") from None
    if data[:4] != _MAGIC or len(data) < 8 + length + len(packed_bits(np.zeros(count, bool))):
        raise FormatError(worn.name, "it is broken; open the character again")
    return 8 + length, count


def painted_file(source: Path) -> Path:
    """Where the painted mask of a character's file is."""
    return source.with_name(f"{source.stem}.apparel.npy")


def clean_mask(worn: Path, bits: bytes) -> np.ndarray:
    """The mask that a page sent, shape (V,), bool.

    Args:
        worn: The file of `save_worn`.
        bits: As of `packed_bits`.

    Raises:
        OptionError: It is of another mesh.
        FormatError: The file is broken.
    """
    _, count = _head(worn, read_bounded(worn))
    if len(bits) != len(packed_bits(np.zeros(count, bool))):
        raise OptionError(f"this is no mask of {count:,} vertices; reload the page")
    return np.unpackbits(np.frombuffer(bits, np.uint8), count=count, bitorder="little").astype(bool)


def paint(mask: np.ndarray, path: Path) -> None:
    """Write a painted mask.

    Raises:
        FormatError: It cannot be written.
    """
    packed = io.BytesIO()
    np.save(packed, mask, allow_pickle=False)
    with atomic_write(path) as file:
        file.write(packed.getvalue())
