"""Tiny files, good and bad, made by hand, and a way to run the command line in this process."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0, 1]], "<f4")
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u2")


def glb_bytes(vertices: np.ndarray = TETRAHEDRON, triangles: np.ndarray | None = TRIANGLES) -> bytes:
    """A GLB of one mesh, written without the library; without triangles it is a point cloud."""
    data = vertices.tobytes()
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}]
    accessors = [{"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"}]
    if len(vertices):
        accessors[0] |= {"min": np.nanmin(vertices, axis=0).tolist(), "max": np.nanmax(vertices, axis=0).tolist()}
    primitive = {"attributes": {"POSITION": 0}, "mode": 0}
    if triangles is not None:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": triangles.nbytes})
        accessors.append({"bufferView": 1, "componentType": 5123, "count": triangles.size, "type": "SCALAR"})
        primitive |= {"indices": 1, "mode": 4}
        data += triangles.tobytes()
    data += b"\0" * (-len(data) % 4)
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


@pytest.fixture(scope="session")
def glb() -> Callable[..., bytes]:
    """`glb_bytes`, which tests cannot import from here."""
    return glb_bytes


@pytest.fixture
def good(tmp_path: Path) -> Path:
    path = tmp_path / "good.glb"
    path.write_bytes(glb_bytes())
    return path
