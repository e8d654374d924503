"""A GLB or glTF file as a document: chunks, JSON, the files it names, and Draco and meshopt data decompressed."""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.files import check_input, path_inside, read_bounded
from bunraku.core.request import parse_json
from bunraku.errors import FormatError, MissingExtraError
from bunraku.files.gltf.document import COMPONENT_TYPES, ELEMENT_SIZES, MAX_ELEMENTS, Document, room

DRACO = "KHR_draco_mesh_compression"
SECONDS = 120
"""Longest time that unpacking may take [s]."""


def unpack_primitives(document: Document) -> None:
    """Give the compressed primitives of a document plain accessors, in place. Primitives whose accessors have data of
    their own, as in files for viewers without Draco, are read from there. FormatError if a primitive is broken, or
    takes more memory than the file may; MissingExtraError if the package that unpacks them is not installed.
    """
    packed: dict[int, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for mesh in document.items("meshes"):
        for primitive in document.objects(mesh, "primitives"):
            extensions = primitive.get("extensions")
            extension = extensions.pop(DRACO, None) if isinstance(extensions, dict) else None
            if extension is None:
                continue
            if not isinstance(extension, dict) or not isinstance(extension.get("attributes"), dict):
                document.broken(f"a primitive lacks what {DRACO} says of it")
            accessors = (document.item("accessors", index) for index in _accessors(document, primitive))
            if not all("bufferView" in accessor for accessor in accessors):
                packed.setdefault(document.integer(extension, "bufferView"), []).append((primitive, extension))
    _forget(document, (DRACO,))
    if not packed:
        return
    if find_spec("DracoPy") is None:
        raise MissingExtraError("DracoPy", "compressed", f"{document.path}: a mesh packed with Draco")
    declared = (_accessors(document, primitive) for users in packed.values() for primitive, _ in users)
    document.check_memory(sum(16 * document.count(index) for indices in declared for index in indices))
    arrays = _draco_unpacked(document, [bytes(document.view(view)) for view in packed])
    for number, users in enumerate(packed.values()):
        for primitive, extension in users:
            _fill(document, primitive, extension, arrays, number)


def _accessors(document: Document, primitive: dict[str, object]) -> list[Any]:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        document.broken("a mesh has a primitive without attributes")
    return [*attributes.values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _draco_unpacked(document: Document, meshes: list[bytes]) -> dict[str, np.ndarray]:
    """Packed meshes as `draco_process` unpacks them."""
    from zipfile import BadZipFile

    size = document.size or sum(map(len, meshes))
    head = json.dumps({"bytes": max(room(size) - size, 0), "lengths": [len(mesh) for mesh in meshes]}) + "\n"
    script = Path(__file__).with_name("draco_process.py")
    try:
        done = subprocess.run(
            [sys.executable, str(script)],
            input=head.encode() + b"".join(meshes),
            capture_output=True,
            timeout=SECONDS,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        with np.load(BytesIO(done.stdout), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (subprocess.TimeoutExpired, BadZipFile, EOFError, ValueError, OSError):
        document.fail("Draco cannot unpack a mesh, within the memory for such a file; export it without compression")


def _fill(
    document: Document,
    primitive: dict[str, object],
    extension: dict[str, object],
    arrays: dict[str, np.ndarray],
    number: int,
) -> None:
    """Put unpacked values behind the accessors of a primitive."""
    attributes = document.entry(primitive, "attributes")
    for name, identity in document.entry(extension, "attributes").items():
        if name not in attributes:
            continue
        values = arrays.get(f"{number}_{identity}")
        if type(identity) is not int or values is None:
            document.broken(f"Draco's data hold no {name:.40} of a mesh")
        _store(document, attributes[name], values.reshape(len(values), -1))
    if "indices" in primitive:
        _store(document, primitive["indices"], arrays[f"{number}_faces"].reshape(-1, 1))


def _store(document: Document, index: Any, values: np.ndarray) -> None:
    accessor = document.item("accessors", index)
    kind, component = accessor.get("type"), accessor.get("componentType")
    dtype = COMPONENT_TYPES.get(component) if type(component) is int else None
    if dtype is None or len(values) != document.count(index) or ELEMENT_SIZES.get(str(kind)) != values.shape[1]:
        document.broken(f"Draco's data and accessors[{index}] disagree about what a mesh holds")
    with np.errstate(invalid="ignore"):
        data = np.ascontiguousarray(values.astype(dtype)).tobytes()
    document.items("bufferViews").append(_added(document, data))
    accessor["bufferView"] = len(document.items("bufferViews")) - 1
    accessor.pop("byteOffset", None)


def _added(document: Document, data: bytes) -> dict[str, int]:
    """The view of bytes that are added as a buffer."""
    document.items("buffers").append({"byteLength": len(data)})
    document.buffers.append(data)
    return {"buffer": len(document.buffers) - 1, "byteOffset": 0, "byteLength": len(data)}


MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_STRIDES = {"ATTRIBUTES": range(4, 257, 4), "TRIANGLES": (2, 4), "INDICES": (2, 4)}
_FILTERS: dict[str, tuple[str, tuple[int, ...]]] = {
    "NONE": ("", tuple(range(4, 257, 4))),
    "OCTAHEDRAL": ("decode_filter_oct", (4, 8)),
    "QUATERNION": ("decode_filter_quat", (8,)),
    "EXPONENTIAL": ("decode_filter_exp", tuple(range(4, 257, 4))),
}
"""Function of each filter and the strides that it takes."""


def unpack_views(document: Document) -> None:
    """Replace the compressed buffer views of a document by plain ones, in place. A view that also lies uncompressed in
    its buffer is read from there. FormatError if a view is broken, or takes more memory than the file may;
    MissingExtraError if the package that unpacks them is not installed.
    """
    packed: list[tuple[int, dict[str, Any], dict[str, Any]]] = []
    for index, view in enumerate(document.items("bufferViews")):
        extensions = view.get("extensions")
        views = [extensions.pop(name) for name in MESHOPT if name in extensions] if isinstance(extensions, dict) else []
        if views and not _plain(document, view):
            if not isinstance(views[0], dict):
                document.broken(f"bufferViews[{index}] is compressed by nothing")
            packed.append((index, view, views[0]))
    _forget(document, MESHOPT)
    if not packed:
        return
    try:
        library: Any = import_module("meshoptimizer")
    except ImportError as error:
        purpose = f"{document.path}: a mesh packed with meshopt"
        raise MissingExtraError("meshoptimizer", "compressed", purpose) from error
    sizes = [
        document.integer(extension, "count", high=MAX_ELEMENTS) * document.integer(extension, "byteStride", high=256)
        for _, _, extension in packed
    ]
    document.check_memory(2 * sum(sizes))
    for index, view, extension in packed:
        data = _unpacked(document, index, extension, library)
        if document.integer(view, "byteLength") != len(data):
            document.broken(f"bufferViews[{index}] unpacks to {len(data)} bytes and not to those that it should have")
        view |= _added(document, data)


def _plain(document: Document, view: dict[str, object]) -> bool:
    """Whether the bytes of a view are there uncompressed too."""
    buffer = document.integer(view, "buffer")
    end = document.integer(view, "byteOffset", 0) + document.integer(view, "byteLength")
    return buffer < len(document.buffers) and end <= len(document.buffers[buffer])


def _forget(document: Document, extensions: tuple[str, ...]) -> None:
    """Remove the extensions from the lists of what the document needs."""
    for key in ("extensionsUsed", "extensionsRequired"):
        names = document.tree.get(key)
        if isinstance(names, list):
            document.tree[key] = [name for name in names if name not in extensions]


def _unpacked(document: Document, index: int, extension: dict[str, object], library: Any) -> bytes:
    count, stride = document.integer(extension, "count", high=MAX_ELEMENTS), document.integer(extension, "byteStride")
    mode, name = str(extension.get("mode"))[:40], str(extension.get("filter", "NONE"))[:40]
    if mode not in _STRIDES or stride not in _STRIDES[mode] or (mode == "TRIANGLES" and count % 3):
        how = f"{count} {mode} of {stride} bytes"
        document.fail(f"bufferViews[{index}] is packed as {how}, which meshopt does not know; export it again")
    if name not in _FILTERS or (name != "NONE" and (mode != "ATTRIBUTES" or stride not in _FILTERS[name][1])):
        how = f"the filter {name} on {mode} of {stride} bytes"
        document.fail(f"bufferViews[{index}] is packed with {how}, which is not read; export it without")
    buffer = document.integer(extension, "buffer")
    start, length = document.integer(extension, "byteOffset", 0), document.integer(extension, "byteLength")
    if buffer >= len(document.buffers) or start + length > len(document.buffers[buffer]):
        document.truncated(f"bufferViews[{index}] is packed in bytes that are not there")
    data = bytes(memoryview(document.buffers[buffer])[start : start + length])
    if not count:
        return b""
    try:
        if mode == "ATTRIBUTES":
            values = library.decode_vertex_buffer(count, stride, data)
            values = np.ascontiguousarray(values).view(np.uint8).reshape(count, stride)
            if name != "NONE":
                values = getattr(library, _FILTERS[name][0])(values, count, stride)
        else:  # always as four bytes: the package writes shorter ones into an array of these
            unpack = library.decode_index_buffer if mode == "TRIANGLES" else library.decode_index_sequence
            values = unpack(count, 4, data).astype("<u2" if stride == 2 else "<u4")
    except (RuntimeError, ValueError):
        document.broken(f"bufferViews[{index}] cannot be unpacked by meshopt")
    return bytes(np.ascontiguousarray(values).tobytes())


_TREE_COSTS = {b"{": 232, b"[": 64, b",": 40}
"""About how many bytes Python takes for what each of these signs of JSON stands for."""

_UNDERSTOOD = (
    DRACO, *MESHOPT, "KHR_mesh_quantization", "KHR_texture_", "KHR_materials_", "KHR_lights_", "KHR_animation_",
    "KHR_xmp", "EXT_texture_", "VRM", "MSFT_",
)  # fmt: skip


def open_document(path: Path, data: bytes) -> Document:
    """Parse a GLB or glTF file and unpack what is compressed in it. Buffers and images are looked for in its folder
    only. FormatError if the file is truncated or broken, needs an extension that is not understood, or points outside
    its folder; MissingExtraError if its meshes are compressed, and the package that unpacks them is not installed.
    """
    if data[:4] == b"glTF":
        text, chunk = _glb_chunks(path, data)
    else:
        text, chunk = memoryview(data), None
    written = bytes(text)
    costs = sum(written.count(sign) * cost for sign, cost in _TREE_COSTS.items())
    Document(path, {}, [], {}, len(data)).check_memory(2 * len(written) + costs)
    try:
        tree = parse_json(written)
    except (ValueError, RecursionError):
        raise FormatError(path, "its JSON is truncated or broken; export or download the file again") from None
    packed = any(name.encode() in written for name in MESHOPT), DRACO.encode() in written
    del written
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise FormatError(path, "this is not a glTF document, it has no 'asset'; export it again as glTF 2.0")
    document = Document(path, tree, [], {})
    if not str(tree["asset"].get("version", "")).startswith("2"):
        version = str(tree["asset"].get("version"))[:10]
        document.fail(f"this is glTF {version} but only version 2 is read; export it again as glTF 2.0")
    _check_extensions(document)
    files = _Files(document)
    for index, buffer in enumerate(document.items("buffers")):
        document.buffers.append(_buffer(files, buffer, chunk if index == 0 else None))
    for index, image in enumerate(document.items("images")):
        if "uri" in image:
            document.images[index] = files.resource(image["uri"], "image", missing_ok=True)
    document = replace(document, size=len(data) + files.size)
    if packed[0]:
        unpack_views(document)
    if packed[1]:
        unpack_primitives(document)
    return document


def _truncated(path: Path, problem: str) -> FormatError:
    return FormatError(path, f"{problem}; it is truncated, export or download it again")


def _glb_chunks(path: Path, data: bytes) -> tuple[memoryview, memoryview | None]:
    if len(data) < 20:
        raise _truncated(path, "the GLB ends inside its header")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FormatError(path, f"this is GLB {version} but only version 2 is read; export it again as glTF 2.0")
    if total > len(data):
        raise _truncated(path, f"the GLB should have {total} bytes but has {len(data)}")
    content, offset = memoryview(data)[:total], 12
    chunks: dict[int, memoryview] = {}
    while offset + 8 <= total:
        length, kind = struct.unpack_from("<II", data, offset)
        if offset + 8 + length > total:
            raise _truncated(path, "a chunk of the GLB is longer than the file")
        chunks.setdefault(kind, content[offset + 8 : offset + 8 + length])
        offset += 8 + length + (-length % 4)
    if 0x4E4F534A not in chunks:
        raise FormatError(path, "the GLB has no JSON chunk; it is broken, export it again")
    return chunks[0x4E4F534A], chunks.get(0x004E4942)


def _check_extensions(document: Document) -> None:
    for key in ("extensionsUsed", "extensionsRequired"):
        names = document.tree.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            document.fail(f"its '{key}' is no list of names; export it again")
    for name in document.tree.get("extensionsRequired", []):
        name = name[:80]
        if not name.startswith(_UNDERSTOOD):
            document.fail(f"it needs the glTF extension {name}, which is not read; export it again without it")


def _buffer(files: _Files, buffer: dict[str, object], chunk: memoryview | None) -> bytes | memoryview:
    document = files.document
    length = document.integer(buffer, "byteLength")
    data: bytes | memoryview | None = files.resource(buffer["uri"], "buffer") if "uri" in buffer else chunk
    if data is None:  # a fallback buffer of a compressed file: views into it fail where they are used
        return b""
    if len(data) < length:
        document.truncated(f"a buffer should have {length} bytes but has {len(data)}")
    return memoryview(data)[:length] if len(data) > length else data


class _Files:
    """The bytes behind the URIs of a document; a file with several references is read once."""

    def __init__(self, document: Document):
        self.document = document
        self.size = 0
        self._known: dict[Path, bytes] = {}

    def resource(self, uri: Any, what: str, missing_ok: bool = False) -> bytes | None:
        """The bytes of a data URI or of a file in the document's folder."""
        document = self.document
        if not isinstance(uri, str):
            document.broken(f"the address of its {what} is not text")
        if uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            try:
                if not head.endswith(";base64"):
                    raise ValueError
                return base64.b64decode(body)
            except (ValueError, binascii.Error):
                document.broken(f"its embedded {what} is not valid base64")
        target = path_inside(document.path.parent, uri)
        if target is None:
            document.fail(
                f"its {what} {uri[:80]!r} is outside the folder of the file and not opened; put it beside the file"
            )
        if target in self._known:
            return self._known[target]
        if not os.path.isfile(target):
            if missing_ok:
                return None
            document.fail(f"its {what} {uri[:80]!r} is missing; put it beside the file, or export a GLB")
        self.size += check_input(target)
        replace(document, size=self.size).check_memory(0)
        self._known[target] = read_bounded(target)
        return self._known[target]
