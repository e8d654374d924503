"""Read PLY and STL, text or binary."""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.files import check_text, path_inside
from bunraku.errors import FormatError
from bunraku.files.gltf.colors import linear_from_srgb
from bunraku.files.gltf.document import Document, matte_material, mesh_document
from bunraku.files.gltf.read import character_from_document
from bunraku.files.meshes.obj import BROKEN, embeddable, fans, parse_numbers

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)  # name, type, type of the list's length


def read_ply(path: Path, data: bytes) -> Character:
    """Read a PLY file; polygons become fans of triangles. A texture that it names is looked for in its folder only.
    FormatError if the file is truncated or broken; CharacterError if what it holds is no character.
    """
    kind, elements, texture, body = _header(path, data)
    vertices: dict[str, np.ndarray] = {}
    triangles = np.zeros((0, 3), np.int64)
    if kind == "ascii":
        check_text(path, data)
    reader = _Body(path, body, {"ascii": "ascii", "binary_big_endian": ">"}.get(kind, "<"))
    for element in elements:
        lists = [entry for entry in element.properties if entry[2]]
        if not lists:
            columns = reader.scalars(element)
            if element.name == "vertex":
                vertices = columns
        elif element.name == "face":
            triangles = _triangles(path, *reader.lists(element))
        elif element.name == "tristrips":
            raise FormatError(path, "its faces are triangle strips, which are not read; export it with plain faces")
        else:
            reader.lists(element)
    if not all(axis in vertices for axis in "xyz"):
        raise FormatError(path, "its vertices have no x, y and z; export it again")
    count = len(vertices["x"])
    if len(triangles) and not 0 <= int(triangles.min()) <= int(triangles.max()) < count:
        raise FormatError(path, f"a face uses vertex {int(triangles.max())} but there are {count}; {BROKEN}")
    return character_from_document(_document(path, vertices, triangles, texture), path.stem, suffix=".ply")


def _document(path: Path, vertices: dict[str, np.ndarray], triangles: np.ndarray, texture: str) -> Document:
    def columns(*choices: tuple[str, ...]) -> np.ndarray | None:
        names = next((choice for choice in choices if all(name in vertices for name in choice)), None)
        return None if names is None else np.stack([vertices[name] for name in names], axis=1)

    positions = np.stack([vertices[axis] for axis in "xyz"], axis=1)
    normals, uvs = columns(("nx", "ny", "nz")), columns(("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
    colors = columns(("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
    if colors is not None:
        scale = 255.0 if np.nan_to_num(colors).max(initial=0) > 1 else 1.0
        if colors.dtype.kind in "iu":
            scale = np.iinfo(colors.dtype).max
        colors = linear_from_srgb(np.clip(np.nan_to_num(colors.astype(float)) / scale, 0, 1))
    if normals is not None:
        length = np.linalg.norm(normals.astype(float), axis=1, keepdims=True)
        normals = normals / length if np.isfinite(length).all() and (length > 1e-12).all() else None
    if uvs is not None:
        uvs = np.nan_to_num(np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1))
    target = path_inside(path.parent, texture) if texture and uvs is not None else None
    image = embeddable(target) if target is not None and os.path.isfile(target) else None
    materials = [matte_material(path.stem, texture=None if image is None else 0)]
    images = [image] if image else None
    return mesh_document(
        path, positions, [(triangles, 0)], normals=normals, uvs=uvs, colors=colors, materials=materials, images=images
    )


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], str, bytes]:
    end = data.find(b"end_header", 0, 1 << 20)
    line_end = data.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise FormatError(path, f"the PLY header has no end; {BROKEN}")
    kind, elements, texture = "", [], ""
    for line in data[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                kind = words[1]
            elif words[:2] == ["comment", "TextureFile"]:
                texture = " ".join(words[2:])
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2])))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append((words[2], _TYPES[words[1]], None))
        except (KeyError, IndexError, ValueError):
            raise FormatError(path, f"the PLY header line {line[:60]!r} cannot be understood; {BROKEN}") from None
    if kind not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise FormatError(
            path, f"the PLY kind {kind[:30]!r} is unknown; export it again as ascii or binary_little_endian"
        )
    if any(element.count < 0 or len(element.properties) > 1000 for element in elements):
        raise FormatError(path, f"the PLY header declares impossible counts; {BROKEN}")
    return kind, elements, texture, data[line_end + 1 :]


def _triangles(path: Path, flat: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Fans of polygons whose vertex indices stand in one row, shape (F, 3)."""
    if (sizes < 0).any() or len(flat) != sizes.sum():
        raise FormatError(path, f"its faces are cut short; {BROKEN}")
    return fans(flat, sizes, sizes)[0]


def _wanted(element: _Element) -> int:
    """Which list property holds the vertices of a face."""
    names = [name for name, _, length in element.properties if length]
    return next((k for k, name in enumerate(names) if name in ("vertex_indices", "vertex_index")), 0)


class _Body:
    """The elements of a file behind its header, in bytes of a byte order; those of a text are its numbers as float64,
    whatever types the header names.
    """

    def __init__(self, path: Path, body: bytes, order: str):
        self.path, self.body, self.at, self.order = path, body, 0, order
        self.text = order == "ascii"
        if self.text:
            try:
                self.body, self.order = parse_numbers(body.split()).tobytes(), "="
            except ValueError:
                raise FormatError(path, f"it holds something that is not a number; {BROKEN}") from None

    def _type(self, name: str) -> np.dtype:
        return np.dtype(self.order + ("f8" if self.text else name))

    def _room(self, size: int) -> None:
        """Raise FormatError unless so many bytes are left."""
        if size > len(self.body) - self.at:
            raise FormatError(self.path, f"it ends before its last element; {BROKEN}")

    def _length(self, kind: np.dtype) -> int:
        """The length of a list, which begins here."""
        self._room(kind.itemsize)
        length = np.frombuffer(self.body, kind, 1, self.at)[0]
        self.at += kind.itemsize
        if not 0 <= length <= len(self.body):
            self._room(len(self.body) + 1)
        return int(length)

    def scalars(self, element: _Element) -> dict[str, np.ndarray]:
        """Columns of an element without lists."""
        dtype = np.dtype([(f"{k}", self._type(kind)) for k, (_, kind, _) in enumerate(element.properties)])
        self._room(element.count * dtype.itemsize)
        rows = np.frombuffer(self.body, dtype, element.count, self.at) if dtype.itemsize else np.zeros(0, dtype)
        self.at += element.count * dtype.itemsize
        with np.errstate(invalid="ignore"):
            return {name: rows[f"{k}"].astype(kind) for k, (name, kind, _) in enumerate(element.properties)}

    def lists(self, element: _Element) -> tuple[np.ndarray, np.ndarray]:
        """The vertex lists of an element, end to end, and the length of each."""
        self._room(element.count * sum(self._type(length or kind).itemsize for _, kind, length in element.properties))
        flat, sizes = self._uniform(element) or self._walk(element)
        if flat.dtype.kind == "f":
            flat = np.where(np.abs(flat) < 2**40, flat, -1)
        return flat.astype(np.int64), sizes

    def _uniform(self, element: _Element) -> tuple[np.ndarray, np.ndarray] | None:
        """All rows at once where every list is as long as in the first row, as in nearly all files."""
        if not element.count:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        fields: list[tuple] = []
        start, wanted = self.at, [number for number, entry in enumerate(element.properties) if entry[2]]
        for number, (_, kind, length) in enumerate(element.properties):
            size = 1
            if length is not None:
                size = self._length(self._type(length))
                fields.append((f"n{number}", self._type(length)))
            if size > 4096:
                break
            fields.append((f"v{number}", self._type(kind), (size,)))
            self.at += size * self._type(kind).itemsize
        self.at, dtype = start, np.dtype(fields)
        whole = len(fields) == len(element.properties) + len(wanted)
        if not whole or element.count * dtype.itemsize > len(self.body) - start:
            return None
        rows = np.frombuffer(self.body, dtype, element.count, start)
        if any((rows[name] != rows[name][0]).any() for name in dtype.names or () if name[0] == "n"):
            return None
        self.at += element.count * dtype.itemsize
        chosen = wanted[_wanted(element)]
        return rows[f"v{chosen}"].reshape(-1), rows[f"n{chosen}"].astype(np.int64)

    def _walk(self, element: _Element) -> tuple[np.ndarray, np.ndarray]:
        flat, sizes, chosen = [], [], _wanted(element)
        plan = [(self._type(kind), self._type(length) if length else None) for _, kind, length in element.properties]
        for _ in range(element.count):
            lists = 0
            for kind, length in plan:
                size = 1 if length is None else self._length(length)
                self._room(size * kind.itemsize)
                if length is not None and lists == chosen:
                    flat.append(np.frombuffer(self.body, kind, size, self.at))
                    sizes.append(size)
                lists += length is not None
                self.at += size * kind.itemsize
        return np.concatenate(flat) if flat else np.zeros(0, np.int64), np.array(sizes, np.int64)


_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path, data: bytes) -> Character:
    """Read an STL file: vertices in the order of their first use, triangles in that of the file. Triangles with two
    corners at one position are dropped. FormatError if the file is truncated or broken; CharacterError if what it holds
    is no character.
    """
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    start = data[:4096].lower()
    text = start.lstrip().startswith(b"solid") and b"facet" in start and len(data) != 84 + 50 * count
    if text:
        check_text(path, data)
    corners = _text(path, data) if text else _binary(path, data, count)
    vertices, triangles = _welded(corners)
    grey = matte_material(path.stem, (0.6, 0.6, 0.6, 1))
    document = mesh_document(path, vertices, [(triangles, 0)], materials=[grey])
    return character_from_document(document, path.stem, suffix=".stl")


def _binary(path: Path, data: bytes, count: int) -> np.ndarray:
    if len(data) < 84 + 50 * count or len(data) < 84:
        raise FormatError(
            path, f"an STL of {count} triangles has {84 + 50 * count} bytes but this one has {len(data)}; {BROKEN}"
        )
    return np.frombuffer(data, _RECORD, count, 84)["corners"].reshape(-1, 3)


def _text(path: Path, data: bytes) -> np.ndarray:
    lines = [line.split()[1:4] for line in data.lower().splitlines() if line.lstrip().startswith(b"vertex")]
    try:
        corners = np.array([[float(number) for number in line] for line in lines]).reshape(-1, 3)
    except ValueError:
        raise FormatError(path, f"a vertex holds something that is not three numbers; {BROKEN}") from None
    if len(corners) % 3 or b"endsolid" not in data[-1024:].lower():
        raise FormatError(path, f"it ends inside a triangle; {BROKEN}")
    return corners


def _welded(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners without repetitions (V, 3), and the triangles that have three different ones (F, 3)."""
    corners = np.ascontiguousarray(corners, np.float32) + np.float32(0)  # no -0.0: the bits are compared
    keys = corners.view(np.dtype((np.void, 12))).ravel()
    _, first, vertex = np.unique(keys, return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first))  # in the order of the file
    triangles = number[vertex].reshape(-1, 3)
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    used, kept = np.unique(triangles[~flat], return_inverse=True)
    return corners[np.sort(first)][used], kept.reshape(-1, 3)
