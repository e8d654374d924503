"""Buffer views compressed with meshopt (EXT_meshopt_compression and KHR_meshopt_compression), unpacked in place."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from bunraku.errors import MissingExtraError
from bunraku.formats.gltf.container.document import MAX_ELEMENTS, Document

__all__ = ["MESHOPT", "unpack_views"]

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_STRIDES = {
    "ATTRIBUTES": range(4, 257, 4),
    "TRIANGLES": (2, 4),
    "INDICES": (2, 4),
}
_FILTERS: dict[str, tuple[str, tuple[int, ...]]] = {
    "NONE": ("", tuple(range(4, 257, 4))),
    "OCTAHEDRAL": ("decode_filter_oct", (4, 8)),
    "QUATERNION": ("decode_filter_quat", (8,)),
    "EXPONENTIAL": ("decode_filter_exp", tuple(range(4, 257, 4))),
}
"""Function of each filter and the strides that it takes."""


def unpack_views(document: Document) -> None:
    """Replace the compressed buffer views of a document by plain ones, in place.

    A view that also lies uncompressed in its buffer is read from there.

    Raises:
        FormatError: A view is broken, or takes more memory than the file may.
        MissingExtraError: The package that unpacks them is not installed.
    """
    packed: list[tuple[int, dict[str, Any], dict[str, Any]]] = []
    for index, view in enumerate(document.items("bufferViews")):
        extensions = view.get("extensions")
        found = [extensions.pop(name) for name in MESHOPT if name in extensions] if isinstance(extensions, dict) else []
        if found and not _plain(document, view):
            if not isinstance(found[0], dict):
                document.fail(f"bufferViews[{index}] is compressed by nothing; the file is broken, export it again")
            packed.append((index, view, found[0]))
    _forget(document)
    if not packed:
        return
    try:
        library: Any = import_module("meshoptimizer")
    except ImportError as error:
        raise MissingExtraError(
            "meshoptimizer", "compressed", f"{document.path}: a mesh packed with meshopt"
        ) from error
    sizes = [
        document.integer(extension, "count", high=MAX_ELEMENTS) * document.integer(extension, "byteStride", high=256)
        for _, _, extension in packed
    ]
    document.check_memory(2 * sum(sizes))
    for index, view, extension in packed:
        data = _unpacked(document, index, extension, library)
        if document.integer(view, "byteLength") != len(data):
            document.fail(
                f"bufferViews[{index}] unpacks to {len(data)} bytes and not to those that it should have; the file is "
                "broken, export it again"
            )
        view |= {"buffer": len(document.buffers), "byteOffset": 0, "byteLength": len(data)}
        document.items("buffers").append({"byteLength": len(data)})
        document.buffers.append(data)


def _plain(document: Document, view: dict[str, object]) -> bool:
    """Whether the bytes that a view stands for are there uncompressed too."""
    buffer = document.integer(view, "buffer")
    end = document.integer(view, "byteOffset", 0) + document.integer(view, "byteLength")
    return buffer < len(document.buffers) and end <= len(document.buffers[buffer])


def _forget(document: Document) -> None:
    """Take the extensions out of the lists of what the document needs."""
    for key in ("extensionsUsed", "extensionsRequired"):
        names = document.tree.get(key)
        if isinstance(names, list):
            document.tree[key] = [name for name in names if name not in MESHOPT]


def _unpacked(document: Document, index: int, extension: dict[str, object], library: Any) -> bytes:
    count, stride = document.integer(extension, "count", high=MAX_ELEMENTS), document.integer(extension, "byteStride")
    mode, name = str(extension.get("mode"))[:40], str(extension.get("filter", "NONE"))[:40]
    if mode not in _STRIDES or stride not in _STRIDES[mode] or (mode == "TRIANGLES" and count % 3):
        document.fail(
            f"bufferViews[{index}] is packed as {count} {mode} of {stride} bytes, which meshopt does not know; export "
            "the file again"
        )
    if name not in _FILTERS or (name != "NONE" and (mode != "ATTRIBUTES" or stride not in _FILTERS[name][1])):
        document.fail(
            f"bufferViews[{index}] is packed with the filter {name} on {mode} of {stride} bytes, which is not read; "
            "export the file again without that filter"
        )
    buffer = document.integer(extension, "buffer")
    start, length = document.integer(extension, "byteOffset", 0), document.integer(extension, "byteLength")
    if buffer >= len(document.buffers) or start + length > len(document.buffers[buffer]):
        document.fail(
            f"bufferViews[{index}] is packed in bytes that are not there; the file is truncated, export or download it "
            "again"
        )
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
        document.fail(f"bufferViews[{index}] cannot be unpacked by meshopt; the file is broken, export it again")
    return bytes(np.ascontiguousarray(values).tobytes())
