"""A glTF 2.0 document in memory, with every index, offset and length checked on use, and how one is built."""

from __future__ import annotations

import json
import struct
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np

from bunraku.errors import FormatError

PER_BYTE = 4
"""Bytes of memory for each byte of a file."""

BASE = 240 << 20
"""What any file may take in addition [bytes]; the interpreter and its libraries make it some 300 MB."""


def free_memory() -> int:
    """Bytes that Linux says the machine can still give; without an answer, the largest integer."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    except (OSError, ValueError, IndexError):
        pass
    return sys.maxsize


def room(size: int) -> int:
    """Most bytes that reading a file may take, its own included; `size` is of the file and of all that it names."""
    return min(PER_BYTE * size + BASE, free_memory())


COMPONENT_TYPES: dict[int, np.dtype[Any]] = {
    code: np.dtype(name)
    for code, name in ((5120, "i1"), (5121, "u1"), (5122, "<i2"), (5123, "<u2"), (5125, "<u4"), (5126, "<f4"))
}
ELEMENT_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
MAX_ELEMENTS = 50_000_000
"""Most elements of one accessor: one may be declared without any data, so the file's size does not bound it."""


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF document."""

    path: Path  # where it came from, for messages
    tree: dict[str, Any]  # the JSON object
    buffers: list[bytes | memoryview]  # the bytes of each buffer; those that name one file share them
    # Bytes of the images that are files or data URIs, by image index; None where the file is missing.
    images: dict[int, bytes | None]
    size: int = 0  # bytes of the file and of the files that it names, each once; 0 for a document in memory only

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: views into the file as bytes of their own."""
        return {**self.__dict__, "buffers": [bytes(buffer) for buffer in self.buffers]}

    @property
    def _own(self) -> int:
        return self.size or sum(len(buffer) for buffer in self.buffers)

    def has_room(self, needed: int) -> bool:
        """Whether a file of this size may take so much memory beside itself [bytes]."""
        return self._own + needed <= room(self._own)

    def check_memory(self, needed: int) -> None:
        """Raise FormatError if so many bytes beside the file are too much for a file of this size or the machine."""
        if not self.has_room(needed):
            size = f"{(self._own + needed) / 1e6:,.0f} MB of memory"
            self.fail(f"it needs {size}, too much for its size or this machine; simplify it, or close other programs")

    def fail(self, problem: str) -> NoReturn:
        """Raise a FormatError about this document."""
        raise FormatError(self.path, problem)

    def broken(self, problem: str) -> NoReturn:
        """Raise a FormatError about damage in this document."""
        self.fail(f"{problem}; the file is broken, export it again")

    def truncated(self, problem: str) -> NoReturn:
        """Raise a FormatError about bytes that this document lacks."""
        self.fail(f"{problem}; the file is truncated, export or download it again")

    @property
    def extensions(self) -> dict[str, Any]:
        """The extensions of the whole document, empty where it has none."""
        extensions = self.tree.get("extensions")
        return extensions if isinstance(extensions, dict) else {}

    def items(self, kind: str) -> list[dict[str, Any]]:
        """A top-level list of the document, empty where it has none."""
        return self.objects(self.tree, kind)

    def objects(self, owner: dict[str, object], key: str) -> list[dict[str, Any]]:
        """A list of objects under a key of an object."""
        value = owner.get(key, [])
        if not isinstance(value, list) or not set(map(type, value)) <= {dict}:
            self.broken(f"'{key}' must be a list of objects")
        return value

    def entry(self, owner: dict[str, object], key: str) -> dict[str, object]:
        """An object under a key of an object."""
        value = owner.get(key)
        if not isinstance(value, dict):
            self.broken(f"'{key}' must be an object")
        return value

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """One entry of a top-level list."""
        items = self.tree.get(kind, [])  # only the entry is checked: files hold thousands, and each is asked for often
        there = isinstance(items, list) and type(index) is int and 0 <= index < len(items)
        if not there or not isinstance(items[index], dict):
            self.broken(f"{kind}[{index!r:.20}] does not exist")
        return items[index]

    def integer(self, owner: dict[str, object], key: str, default: int | None = None, high: int = 2**40) -> int:
        """A non-negative whole number under a key of an object."""
        value = owner.get(key, default)
        if type(value) is float and value.is_integer():
            value = int(value)
        if type(value) is not int or not 0 <= value <= high:
            self.broken(f"'{key}' must be a whole number from 0 to {high}, not {value!r:.40}")
        return value

    def numbers(self, owner: dict[str, object], key: str, default: list[float]) -> np.ndarray:
        """A list of finite numbers under a key of an object, as long as the default, float64."""
        value = owner.get(key, default)
        good = isinstance(value, list) and len(value) == len(default) and set(map(type, value)) <= {int, float}
        out = np.array(value, float) if good else np.array([np.nan])
        if not np.isfinite(out).all():
            self.broken(f"'{key}' must be {len(default)} finite numbers")
        return out

    def indices(self, owner: dict[str, object], key: str, kind: str) -> list[int]:
        """A list of indices into a top-level list, under a key of an object."""
        value, listed = owner.get(key, []), self.tree.get(kind, [])  # whose entries are not checked, as in `item`
        count = len(listed) if isinstance(listed, list) else 0
        if not isinstance(value, list) or not all(type(x) is int and 0 <= x < count for x in value):
            self.broken(f"'{key}' points at {kind} that do not exist")
        return value

    def view(self, index: Any) -> memoryview:
        """The bytes of a buffer view."""
        view = self.item("bufferViews", index)
        buffer = self.integer(view, "buffer")
        if buffer >= len(self.buffers):
            self.broken(f"buffer {buffer} does not exist")
        start, length = self.integer(view, "byteOffset", 0), self.integer(view, "byteLength")
        data = memoryview(self.buffers[buffer])
        if start + length > len(data):
            self.truncated(f"bufferViews[{index}] ends at byte {start + length} of {len(data)}")
        return data[start : start + length]

    def image(self, index: Any) -> bytes | memoryview | None:
        """The encoded bytes of an image; None where its file is missing."""
        entry = self.item("images", index)
        data = self.images.get(index)
        return self.view(entry["bufferView"]) if data is None and "bufferView" in entry else data

    def count(self, index: Any) -> int:
        """Number of elements of an accessor."""
        return self.integer(self.item("accessors", index), "count", high=MAX_ELEMENTS)

    def accessor(self, index: Any, kinds: tuple[str, ...], raw: bool = False) -> np.ndarray:
        """The elements of an accessor of one of some types ("VEC3" ...), sparse values put in place, shape (count,
        components), in their stored type or float32: normalised integers become floats unless `raw`.
        """
        accessor = self.item("accessors", index)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if kind not in kinds:
            self.broken(f"accessors[{index}] has type {kind!r:.20} where {' or '.join(kinds)} is needed")
        dtype = COMPONENT_TYPES.get(component) if type(component) is int else None
        if dtype is None:
            self.broken(f"accessors[{index}] has component type {component!r:.20}, which glTF does not know")
        count, size = self.count(index), ELEMENT_SIZES[kind]
        if "bufferView" in accessor:
            values = self._elements(accessor, accessor["bufferView"], dtype, count, size)
        else:
            self.check_memory(count * size * dtype.itemsize)
            values = np.zeros((count, size), dtype)
        sparse = accessor.get("sparse")
        if isinstance(sparse, dict):
            values = self._sparse(sparse, values.copy(), dtype)
        if raw or not accessor.get("normalized") or dtype.kind == "f":
            return values
        scaled: np.ndarray = values.astype(np.float32) / np.float32(np.iinfo(dtype).max)
        return np.maximum(scaled, -1, out=scaled)

    def _elements(self, owner: dict[str, object], view: Any, dtype: np.dtype, count: int, size: int) -> np.ndarray:
        data = self.view(view)
        offset = self.integer(owner, "byteOffset", 0)
        width = dtype.itemsize * size
        stride = self.integer(self.item("bufferViews", view), "byteStride", width, high=65535)
        if stride < width:
            self.broken(f"bufferViews[{view}] packs elements of {width} bytes every {stride}")
        if count and offset + stride * (count - 1) + width > len(data):
            self.truncated(f"an accessor reads past the end of bufferViews[{view}]")
        if not count:
            return np.zeros((0, size), dtype)
        return np.ndarray((count, size), dtype, data, offset, (stride, dtype.itemsize))

    def _sparse(self, sparse: dict[str, object], values: np.ndarray, dtype: np.dtype) -> np.ndarray:
        count = self.integer(sparse, "count", high=len(values))
        where, changed = sparse.get("indices"), sparse.get("values")
        if (
            not isinstance(where, dict)
            or not isinstance(changed, dict)
            or where.get("componentType") not in (5121, 5123, 5125)
        ):
            self.broken("a sparse accessor lacks its indices or values")
        rows = self._elements(where, where.get("bufferView"), COMPONENT_TYPES[where["componentType"]], count, 1)[:, 0]
        if count and int(rows.max()) >= len(values):
            self.broken("a sparse accessor replaces elements that do not exist")
        values[rows] = self._elements(changed, changed.get("bufferView"), dtype, count, values.shape[1])
        return values


ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPE_CODES = {dtype: code for code, dtype in COMPONENT_TYPES.items()}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfBuilder:
    """A glTF tree and the binary chunk that grows with it; its `accessors` and `bufferViews` start empty."""

    def __init__(self, tree: dict[str, Any] | None = None):
        if tree is None:
            tree = {"asset": {"version": "2.0", "generator": "bunraku"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.tree: dict[str, Any] = tree  # our own from here on: what is added is what glTF says
        self.length = 0
        self._chunks: list[bytes | memoryview | Callable[[], bytes]] = []
        for key in ("accessors", "bufferViews", "buffers"):
            tree.pop(key, None)

    def add(self, key: str, entry: dict[str, object]) -> int:
        """Add an entry to a top-level list and return its index."""
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
        return self.add("bufferViews", entry)

    def array(self, values: np.ndarray, target: int | None = None, bounds: bool = False, **extra: object) -> int:
        """Add an array of shape (count, components), of a type that glTF has, as an accessor with its `bounds` perhaps
        and further properties, and return its index; `target` is what the GPU uses it for.
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
        return self.add("accessors", entry)

    def matrices(self, values: np.ndarray) -> int:
        """Add matrices (N, 4, 4), column after column, as an accessor and return its index."""
        return self.array(values.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))

    def bones(self, names: Sequence[str], parents: Sequence[int] | np.ndarray, offsets: np.ndarray) -> list[int]:
        """Add a node for each bone, moved from its parent's by an offset [m] (J, 3), and return the nodes."""
        first = len(self.tree.get("nodes", []))
        below: dict[int, list[int]] = {}
        for bone, parent in enumerate(parents):
            below.setdefault(int(parent), []).append(first + bone)
        for bone, (name, offset) in enumerate(zip(names, offsets.tolist(), strict=True)):
            node = {"name": name, "translation": offset}
            self.add("nodes", {**node, "children": below[bone]} if bone in below else node)
        return list(range(first, first + len(names)))

    def later(self, count: int, size: int, make: Callable[[int], bytes]) -> int:
        """Add an accessor of `count` vectors of 32-bit floats, whose bytes `make(count)` gives when the document is
        written, and return its index.
        """
        length = 4 * count * size
        entry: dict[str, object] = {"buffer": 0, "byteOffset": self.length, "byteLength": length}
        self._chunks.append(lambda: make(count))
        self.length += length
        view = self.add("bufferViews", entry)
        return self.add("accessors", {"componentType": 5126, "count": count, "type": _KINDS[size], "bufferView": view})

    def zeros(self, accessor: dict[str, object]) -> int:
        """Add an accessor that has no data behind it and return its index."""
        return self.add("accessors", accessor)

    def image(self, data: bytes | memoryview, mime: str, **extra: object) -> int:
        """Add an embedded image and return its index."""
        return self.add("images", {**extra, "mimeType": mime, "bufferView": self.view(data)})

    @staticmethod
    def channel(clip: dict[str, Any], node: int, path: str, times: int, values: int) -> None:
        """Add a linear channel to a clip that has lists of channels and samplers: a node's property, by accessors."""
        clip["channels"].append({"sampler": len(clip["samplers"]), "target": {"node": node, "path": path}})
        clip["samplers"].append({"input": times, "output": values, "interpolation": "LINEAR"})

    def clip(self, name: str, times: np.ndarray, tracks: Sequence[tuple[int, str, np.ndarray]]) -> None:
        """Add a clip of linear channels: times of the keys [s] (N,), float32, and node, property and keys (N, C) of
        each, one key where nothing moves.
        """
        every, once = self.array(times[:, None], bounds=True), None
        clip: dict[str, Any] = {"name": name, "channels": [], "samplers": []}
        for node, path, keys in tracks:
            if len(keys) < len(times) and once is None:
                once = self.array(times[:1, None], bounds=True)
            clock = once if len(keys) < len(times) and once is not None else every
            self.channel(clip, node, path, clock, self.array(keys))
        self.add("animations", clip)

    def document(self, path: Path) -> Document:
        """The document as one in memory."""
        data = b"".join(chunk() if callable(chunk) else chunk for chunk in self._chunks)
        if data:
            self.tree["buffers"] = [{"byteLength": len(data)}]
        return Document(path, self.tree, [data] if data else [], {})

    def write(self, file: BinaryIO) -> None:
        """Write the document as GLB. ValueError if it is larger than a GLB can be, or the tree holds numbers that JSON
        lacks.
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


def matte_material(
    name: str, color: Sequence[float] | None = None, texture: int | None = None, **more: object
) -> dict[str, Any]:
    """A glTF material that is rough and no metal, as files of formats without such properties mean it: of a linear base
    colour and opacity, which blends below 1, and the index of a base colour texture.
    """
    shader: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 0.9}
    if texture is not None:
        shader["baseColorTexture"] = {"index": texture}
    if color is not None:
        shader["baseColorFactor"] = [float(value) for value in color]
    blend = {"alphaMode": "BLEND"} if color is not None and color[3] < 1 else {}
    return {"name": name, "pbrMetallicRoughness": shader, **blend, **more}


def vertex_attributes(
    builder: GltfBuilder,
    positions: np.ndarray,
    normals: np.ndarray | None = None,
    uvs: np.ndarray | None = None,
    colors: np.ndarray | None = None,
) -> dict[str, int]:
    """Accessors of vertices by their names, none where there are no vertices: positions [m] (V, 3), unit normals (V,
    3), texture coordinates with v downwards (V, 2), and linear colours from 0 to 1 (V, 3).
    """
    if not len(positions):
        return {}
    out = {"POSITION": builder.array(positions.astype(np.float32), ARRAY_BUFFER)}
    if normals is not None:
        out["NORMAL"] = builder.array(normals.astype(np.float32), ARRAY_BUFFER)
    if uvs is not None:
        out["TEXCOORD_0"] = builder.array(uvs.astype(np.float32), ARRAY_BUFFER)
    if colors is not None:
        stored = np.full((len(colors), 4), 65535, "<u2")
        stored[:, :3] = np.round(65535 * np.clip(colors, 0, 1))
        out["COLOR_0"] = builder.array(stored, ARRAY_BUFFER, normalized=True)
    return out


def triangle_primitives(
    builder: GltfBuilder, attributes: dict[str, int], count: int, triangles: Iterable[tuple[np.ndarray, int | None]]
) -> list[dict[str, Any]]:
    """Primitives of `count` vertices with these attributes: one for each list of triangles (F, 3) and its material, or
    points where there is no triangle.
    """
    out: list[dict[str, Any]] = []
    for faces, material in triangles:
        if len(faces) and attributes:
            stored = np.ascontiguousarray(faces).reshape(-1, 1).astype("<u2" if count < 65535 else "<u4")
            primitive = {"attributes": attributes, "indices": builder.array(stored, ELEMENT_ARRAY_BUFFER)}
            out.append(primitive if material is None else {**primitive, "material": material})
    return out or ([{"attributes": attributes, "mode": 0}] if attributes else [])


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
        positions: Positions [m], shape (V, 3).
        triangles: For each primitive, vertex indices, shape (F, 3), and its material.
        normals, uvs, colors: Of unit length (V, 3); with v downwards (V, 2); linear, 0 to 1 (V, 3).
        materials: glTF materials; their textures are numbered as the images.
        images: PNG or JPEG bytes with their MIME type.
    """
    builder = GltfBuilder()
    builder.add("nodes", {"name": path.stem, "mesh": 0})
    attributes = vertex_attributes(builder, positions, normals, uvs, colors)
    primitives = triangle_primitives(builder, attributes, len(positions), triangles)
    builder.tree["meshes"] = [{"name": path.stem, "primitives": primitives}]
    for data, mime in images or []:
        builder.add("textures", {"source": builder.image(data, mime)})
    if materials:
        builder.tree["materials"] = materials
    return builder.document(path)


def scaled_mesh_document(document: Document, factor: float) -> Document:
    """A document of `mesh_document` with its positions, the first array of its buffer, times a factor."""
    primitive = document.items("meshes")[0]["primitives"][0]
    count = 3 * document.count(primitive["attributes"]["POSITION"])
    data = np.frombuffer(document.buffers[0], np.uint8).copy()
    positions = data[: 4 * count].view("<f4")
    positions *= np.float32(factor)
    return replace(document, buffers=[data.tobytes(), *document.buffers[1:]])
