"""Read STL, text or binary: triangles that share no vertices, kept as they are."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.formats.files import check_text
from bunraku.formats.gltf.builder import mesh_document
from bunraku.formats.gltf.read import character_from_document

__all__ = ["read_stl"]

_BROKEN = "the file is truncated or broken, export it again"
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path, data: bytes) -> Character:
    """Read an STL file; vertex 3 f + c is corner c of triangle f.

    Args:
        path: The file.
        data: Its bytes.

    Raises:
        FormatError: The file is truncated or broken.
        CharacterError: What it holds is no character.
    """
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    text = (
        data[:512].lstrip().lower().startswith(b"solid")
        and b"facet" in data[:4096].lower()
        and len(data) != 84 + 50 * count
    )
    if text:
        check_text(path, data)
    corners = _text(path, data) if text else _binary(path, data, count)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    material = {
        "name": path.stem,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9, "baseColorFactor": [0.6, 0.6, 0.6, 1]},
    }
    document = mesh_document(path, corners, [(triangles, 0)], materials=[material])
    return character_from_document(document, path.stem, suffix=".stl")


def _binary(path: Path, data: bytes, count: int) -> np.ndarray:
    if len(data) < 84 + 50 * count or len(data) < 84:
        raise FormatError(
            path, f"an STL of {count} triangles has {84 + 50 * count} bytes but this one has {len(data)}; {_BROKEN}"
        )
    return np.frombuffer(data, _RECORD, count, 84)["corners"].reshape(-1, 3)


def _text(path: Path, data: bytes) -> np.ndarray:
    lines = [line.split()[1:4] for line in data.lower().splitlines() if line.lstrip().startswith(b"vertex")]
    try:
        corners = np.array([[float(number) for number in line] for line in lines]).reshape(-1, 3)
    except ValueError:
        raise FormatError(path, f"a vertex holds something that is not three numbers; {_BROKEN}") from None
    if len(corners) % 3 or b"endsolid" not in data[-1024:].lower():
        raise FormatError(path, f"it ends inside a triangle; {_BROKEN}")
    return corners
