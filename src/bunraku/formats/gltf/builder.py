"""Build a glTF document piece by piece: arrays become accessors of their own, and all of it one GLB."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from bunraku.formats.gltf.container.document import COMPONENT_TYPES, Document

__all__ = ["ARRAY_BUFFER", "ELEMENT_ARRAY_BUFFER", "GltfBuilder", "mesh_document", "scaled_mesh_document"]

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPE_CODES = {dtype: code for code, dtype in COMPONENT_TYPES.items()}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfBuilder:
    """A glTF tree and the binary chunk that grows with it.

    Args:
        tree: The JSON object; its `accessors` and `bufferViews` start empty.
    """

    def __init__(self, tree: dict[str, object]):
        self.tree: dict[str, Any] = tree  # our own from here on: what is added is what glTF says
        self.length = 0
        self._chunks: list[bytes | memoryview | Callable[[], bytes]] = []
        for key in ("accessors", "bufferViews", "buffers"):
            tree.pop(key, None)

    def _append(self, key: str, entry: dict[str, object]) -> int:
        entries: list[dict[str, object]] = self.tree.setdefault(key, [])
        entries.append(entry)
        return len(entries) - 1

    def view(self, data: bytes | memoryview, target: int | None = None, stride: int | None = None) -> int:
        """Add bytes as a buffer view and return its index."""
        entry: dict[str, Any] = {"buffer": 0, "byteOffset": self.length, "byteLength": len(data)}
        if stride is not None:
            entry["byteStride"] = stride
        if target is not None:
            entry["target"] = target
        padding = -len(data) % 4
        self._chunks += [data, bytes(padding)] if padding else [data]
        self.length += len(data) + padding
        return self._append("bufferViews", entry)

    def array(self, values: np.ndarray, target: int | None = None, bounds: bool = False, **extra: object) -> int:
        """Add an array of shape (count, components) as an accessor and return its index.

        Args:
            values: The elements, of a type that glTF has.
            target: What the GPU uses it for.
            bounds: Whether to write the smallest and largest values.
            **extra: Further properties of the accessor, such as `normalized`.
        """
        values = np.ascontiguousarray(values)
        count, size = values.shape
        width, stride = size * values.itemsize, None
        entry = {"componentType": _TYPE_CODES[values.dtype], "count": count, "type": _KINDS[size], **extra}
        if bounds:
            entry["min"], entry["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        if target == ARRAY_BUFFER and width % 4:
            padded = np.zeros((count, -(-width // 4) * 4), np.uint8)
            padded[:, :width] = values.view(np.uint8).reshape(count, width)
            values, stride = padded, padded.shape[1]
        entry["bufferView"] = self.view(values.reshape(-1).view(np.uint8).data, target, stride)
        return self._append("accessors", entry)

    def later(self, count: int, size: int, make: Callable[[int], bytes]) -> int:
        """Add an accessor of 32-bit floats whose bytes are made when the document is written, and return its index.

        Args:
            count: How many elements.
            size: Components of each.
            make: Gives the bytes of that many elements.
        """
        length = 4 * count * size
        entry: dict[str, object] = {"buffer": 0, "byteOffset": self.length, "byteLength": length}
        self._chunks.append(lambda: make(count))
        self.length += length
        view = self._append("bufferViews", entry)
        return self._append(
            "accessors", {"componentType": 5126, "count": count, "type": _KINDS[size], "bufferView": view}
        )

    def zeros(self, accessor: dict[str, object]) -> int:
        """Add an accessor that has no data behind it and return its index."""
        return self._append("accessors", accessor)

    def image(self, data: bytes | memoryview, mime: str, **extra: object) -> int:
        """Add an embedded image and return its index."""
        return self._append("images", {**extra, "mimeType": mime, "bufferView": self.view(data)})

    def add(self, key: str, entry: dict[str, object]) -> int:
        """Add an entry to a top-level list and return its index."""
        return self._append(key, entry)

    def document(self, path: Path) -> Document:
        """The document as one in memory."""
        data = b"".join(chunk() if callable(chunk) else chunk for chunk in self._chunks)
        if data:
            self.tree["buffers"] = [{"byteLength": len(data)}]
        return Document(path, self.tree, [data] if data else [], {})

    def write(self, file: BinaryIO) -> None:
        """Write the document as GLB.

        Raises:
            ValueError: It is larger than a GLB can be, or the tree holds numbers that JSON has not.
        """
        if self.length:
            self.tree["buffers"] = [{"byteLength": self.length}]
        text = json.dumps(self.tree, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + (8 + self.length if self.length else 0)
        if total > 0xFFFFFFFF:
            raise ValueError("the GLB would have more than 4 GiB")
        file.write(struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A))
        file.write(text)
        if self.length:
            file.write(struct.pack("<II", self.length, 0x004E4942))
            for chunk in self._chunks:
                file.write(chunk() if callable(chunk) else chunk)


def mesh_document(
    path: Path,
    positions: np.ndarray,
    triangles: list[tuple[np.ndarray, int | None]],
    *,
    normals: np.ndarray | None = None,
    uvs: np.ndarray | None = None,
    colors: np.ndarray | None = None,
    materials: list[dict[str, object]] | None = None,
    images: list[tuple[bytes, str]] | None = None,
) -> Document:
    """A glTF document of one mesh, for files of formats that are not glTF.

    Args:
        path: The file that the mesh came from.
        positions: Positions [m], shape (V, 3).
        triangles: For each primitive, vertex indices, shape (F, 3), and its material.
        normals: Unit normals, shape (V, 3).
        uvs: Texture coordinates with v downwards, shape (V, 2).
        colors: Linear colours from 0 to 1, shape (V, 3).
        materials: glTF materials; their textures are numbered as the images.
        images: PNG or JPEG bytes with their MIME type.
    """
    builder = GltfBuilder({"asset": {"version": "2.0", "generator": "bunraku"}, "scene": 0, "scenes": [{"nodes": [0]}]})
    builder.add("nodes", {"name": path.stem, "mesh": 0})
    attributes = {}
    if len(positions):
        attributes["POSITION"] = builder.array(positions.astype(np.float32), ARRAY_BUFFER)
        if normals is not None:
            attributes["NORMAL"] = builder.array(normals.astype(np.float32), ARRAY_BUFFER)
        if uvs is not None:
            attributes["TEXCOORD_0"] = builder.array(uvs.astype(np.float32), ARRAY_BUFFER)
        if colors is not None:
            stored = np.full((len(colors), 4), 65535, "<u2")
            stored[:, :3] = np.round(65535 * np.clip(colors, 0, 1))
            attributes["COLOR_0"] = builder.array(stored, ARRAY_BUFFER, normalized=True)
    primitives = []
    for faces, material in triangles:
        if len(faces) and attributes:
            kind = "<u2" if len(positions) < 65535 else "<u4"
            primitive = {
                "attributes": attributes,
                "indices": builder.array(faces.reshape(-1, 1).astype(kind), ELEMENT_ARRAY_BUFFER),
            }
            primitives.append(primitive if material is None else {**primitive, "material": material})
    if not primitives and attributes:
        primitives = [{"attributes": attributes, "mode": 0}]
    builder.tree["meshes"] = [{"name": path.stem, "primitives": primitives}]
    for data, mime in images or []:
        builder.add("textures", {"source": builder.image(data, mime)})
    if materials:
        builder.tree["materials"] = materials
    return builder.document(path)


def scaled_mesh_document(document: Document, factor: float) -> Document:
    """A document of `mesh_document` with its positions times a factor; they are the first array of its buffer."""
    primitive = document.items("meshes")[0]["primitives"][0]
    count = 3 * document.count(primitive["attributes"]["POSITION"])
    data = np.frombuffer(document.buffers[0], np.uint8).copy()
    positions = data[: 4 * count].view("<f4")
    positions *= np.float32(factor)
    return replace(document, buffers=[data.tobytes(), *document.buffers[1:]])
