"""Read STL, text or binary.

Its triangles repeat their corners; corners at exactly the same position become one vertex, so that the surface hangs
together.
"""

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
    """Read an STL file; vertices are numbered as they come first, triangles keep their order.

    Triangles with two corners at one position have no surface and are dropped.

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
    vertices, triangles = _welded(corners)
    material: dict[str, object] = {
        "name": path.stem,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.9, "baseColorFactor": [0.6, 0.6, 0.6, 1]},
    }
    document = mesh_document(path, vertices, [(triangles, 0)], materials=[material])
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


def _welded(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners without repetitions, and the triangles that have three different ones, shapes (V, 3) and (F, 3)."""
    corners = np.ascontiguousarray(corners, np.float32) + np.float32(0)  # no -0.0: the bits are compared
    keys = corners.view(np.dtype((np.void, 12))).ravel()
    _, first, vertex = np.unique(keys, return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first))  # in the order of the file
    triangles = number[vertex].reshape(-1, 3)
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    used, kept = np.unique(triangles[~flat], return_inverse=True)
    return corners[np.sort(first)][used], kept.reshape(-1, 3)
