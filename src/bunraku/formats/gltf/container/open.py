"""A GLB or glTF file as a document: its chunks, its JSON, the files that it names, and what is compressed unpacked."""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from bunraku.errors import FormatError
from bunraku.formats.files import check_input, inside, read_bounded
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.container.draco import DRACO, unpack_primitives
from bunraku.formats.gltf.container.meshopt import MESHOPT, unpack_views

__all__ = ["open_document"]

_TREE_COSTS = {b"{": 232, b"[": 64, b",": 40}
"""About how many bytes Python takes for what each of these signs of JSON stands for."""

_UNDERSTOOD = (
    DRACO,
    *MESHOPT,
    "KHR_mesh_quantization",
    "KHR_texture_",
    "KHR_materials_",
    "KHR_lights_",
    "KHR_animation_",
    "KHR_xmp",
    "EXT_texture_",
    "VRM",
    "MSFT_",
)


def open_document(path: Path, data: bytes) -> Document:
    """Parse a GLB or glTF file.

    Args:
        path: The file; buffers and images are looked for in its folder only.
        data: Its bytes.

    Returns:
        The document, with what is compressed in it unpacked.

    Raises:
        FormatError: The file is truncated or broken, needs an extension that is not understood, or points outside its
            folder.
        MissingExtraError: Its meshes are compressed, and the package that unpacks them is not installed.
    """
    if data[:4] == b"glTF":
        text, chunk = _glb_chunks(path, data)
    else:
        text, chunk = memoryview(data), None
    written = bytes(text)
    Document(path, {}, [], {}, len(data)).check_memory(
        2 * len(written) + sum(written.count(sign) * cost for sign, cost in _TREE_COSTS.items())
    )
    try:
        tree = json.loads(written.decode("utf-8-sig"), parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise FormatError(
            path, "its JSON cannot be parsed; the file is truncated or broken, export or download it again"
        ) from None
    packed = any(name.encode() in written for name in MESHOPT), DRACO.encode() in written
    del written
    if not isinstance(tree, dict) or not isinstance(tree.get("asset"), dict):
        raise FormatError(path, "this is not a glTF document, it has no 'asset'; export it again as glTF 2.0")
    document = Document(path, tree, [], {})
    if not str(tree["asset"].get("version", "")).startswith("2"):
        document.fail(
            f"this is glTF {str(tree['asset'].get('version'))[:10]} but only version 2 is read; export it again as "
            "glTF 2.0"
        )
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


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _glb_chunks(path: Path, data: bytes) -> tuple[memoryview, memoryview | None]:
    if len(data) < 20:
        raise FormatError(path, "the GLB ends inside its header; it is truncated, export or download it again")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FormatError(
            path, f"this is GLB version {version} but only version 2 is read; export it again as glTF 2.0"
        )
    if total > len(data):
        raise FormatError(
            path, f"the GLB should have {total} bytes but has {len(data)}; it is truncated, export or download it again"
        )
    whole, offset = memoryview(data)[:total], 12
    chunks: dict[int, memoryview] = {}
    while offset + 8 <= total:
        length, kind = struct.unpack_from("<II", data, offset)
        if offset + 8 + length > total:
            raise FormatError(
                path, "a chunk of the GLB is longer than the file; it is truncated, export or download it again"
            )
        chunks.setdefault(kind, whole[offset + 8 : offset + 8 + length])
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
            document.fail(
                f"it needs the glTF extension {name}, which is not read; export it again without that extension"
            )


def _buffer(files: _Files, buffer: dict[str, object], chunk: memoryview | None) -> bytes | memoryview:
    document = files.document
    length = document.integer(buffer, "byteLength")
    data: bytes | memoryview
    if "uri" in buffer:
        data = files.resource(buffer["uri"], "buffer") or b""
    elif chunk is not None:
        data = chunk
    else:
        data = b""  # a fallback buffer of a compressed file: views into it fail where they are used
        length = 0
    if len(data) < length:
        document.fail(
            f"a buffer should have {length} bytes but has {len(data)}; the file is truncated, export or download it "
            "again"
        )
    return memoryview(data)[:length] if len(data) > length else data


class _Files:
    """What the URIs of a document stand for; a file that many name is read once."""

    def __init__(self, document: Document):
        self.document = document
        self.size = 0
        self._known: dict[Path, bytes] = {}

    def resource(self, uri: Any, what: str, missing_ok: bool = False) -> bytes | None:
        """The bytes of a data URI or of a file in the document's folder."""
        document = self.document
        if not isinstance(uri, str):
            document.fail(f"the address of its {what} is not text; the file is broken, export it again")
        if uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            try:
                if not head.endswith(";base64"):
                    raise ValueError
                return base64.b64decode(body)
            except (ValueError, binascii.Error):
                document.fail(f"its embedded {what} is not valid base64; the file is broken, export it again")
        target = inside(document.path.parent, uri)
        if target is None:
            document.fail(
                f"its {what} {uri[:80]!r} is not in the folder of the file, so it is not opened; put the {what} beside "
                "the file"
            )
        if target in self._known:
            return self._known[target]
        if not os.path.isfile(target):
            if missing_ok:
                return None
            document.fail(
                f"its {what} {uri[:80]!r} is missing; put it beside the file, or export a GLB, which holds everything"
            )
        self.size += check_input(target)
        replace(document, size=self.size).check_memory(0)
        self._known[target] = read_bounded(target)
        return self._known[target]
