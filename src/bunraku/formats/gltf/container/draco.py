"""Primitives compressed with Draco (KHR_draco_mesh_compression), unpacked in place."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import MissingExtraError
from bunraku.formats.gltf.container.document import COMPONENT_TYPES, ELEMENT_SIZES, Document
from bunraku.formats.memory import room

__all__ = ["DRACO", "unpack_primitives"]

DRACO = "KHR_draco_mesh_compression"
SECONDS = 120
"""Longest time that unpacking may take [s]."""


def unpack_primitives(document: Document) -> None:
    """Give the compressed primitives of a document plain accessors, in place.

    Primitives whose accessors have data of their own, as those of files for viewers without Draco do, are read from
    there.

    Raises:
        FormatError: A primitive is broken, or takes more memory than the file may.
        MissingExtraError: The package that unpacks them is not installed.
    """
    packed: dict[int, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for mesh in document.items("meshes"):
        for primitive in document.objects(mesh, "primitives"):
            extensions = primitive.get("extensions")
            extension = extensions.pop(DRACO, None) if isinstance(extensions, dict) else None
            if extension is None:
                continue
            if not isinstance(extension, dict) or not isinstance(extension.get("attributes"), dict):
                document.fail(f"a primitive lacks what {DRACO} says of it; the file is broken, export it again")
            if not _plain(document, primitive):
                packed.setdefault(document.integer(extension, "bufferView"), []).append((primitive, extension))
    for key in ("extensionsUsed", "extensionsRequired"):
        names = document.tree.get(key)
        if isinstance(names, list):
            document.tree[key] = [name for name in names if name != DRACO]
    if not packed:
        return
    if find_spec("DracoPy") is None:
        raise MissingExtraError("DracoPy", "compressed", f"{document.path}: a mesh packed with Draco")
    document.check_memory(_declared(document, packed))
    arrays = _unpacked(document, [bytes(document.view(view)) for view in packed])
    for number, users in enumerate(packed.values()):
        for primitive, extension in users:
            _fill(document, primitive, extension, arrays, number)


def _accessors(document: Document, primitive: dict[str, object]) -> list[Any]:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        document.fail("a mesh has a primitive without attributes; the file is broken, export it again")
    return [*attributes.values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _plain(document: Document, primitive: dict[str, object]) -> bool:
    """Whether all accessors of a primitive have data of their own."""
    return all("bufferView" in document.item("accessors", index) for index in _accessors(document, primitive))


def _declared(document: Document, packed: dict[int, list[tuple[dict[str, object], dict[str, object]]]]) -> int:
    """About how many bytes the accessors of the packed primitives say that they take."""
    total = 0
    for users in packed.values():
        for primitive, _ in users:
            total += sum(16 * document.count(index) for index in _accessors(document, primitive))
    return total


def _unpacked(document: Document, meshes: list[bytes]) -> dict[str, np.ndarray]:
    """What `draco_process` makes of packed meshes."""
    from zipfile import BadZipFile

    own = document.size or sum(map(len, meshes))
    head = json.dumps({"bytes": max(room(own) - own, 0), "lengths": [len(mesh) for mesh in meshes]}) + "\n"
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
        document.fail(
            "a mesh cannot be unpacked by Draco, or takes more memory than a file of this size may; it is broken, "
            "export it again without compression"
        )


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
            document.fail(f"Draco's data hold no {name:.40} of a mesh; the file is broken, export it again")
        _store(document, attributes[name], values.reshape(len(values), -1))
    if "indices" in primitive:
        _store(document, primitive["indices"], arrays[f"{number}_faces"].reshape(-1, 1))


def _store(document: Document, index: Any, values: np.ndarray) -> None:
    accessor = document.item("accessors", index)
    kind, component = accessor.get("type"), accessor.get("componentType")
    dtype = COMPONENT_TYPES.get(component) if type(component) is int else None
    if dtype is None or len(values) != document.count(index) or ELEMENT_SIZES.get(str(kind)) != values.shape[1]:
        document.fail(
            f"Draco's data and accessors[{index}] disagree about what a mesh holds; the file is broken, export it again"
        )
    with np.errstate(invalid="ignore"):
        data = np.ascontiguousarray(values.astype(dtype)).tobytes()
    view = {"buffer": len(document.buffers), "byteLength": len(data)}
    document.items("buffers").append({"byteLength": len(data)})
    document.buffers.append(data)
    document.items("bufferViews").append(view)
    accessor["bufferView"] = len(document.items("bufferViews")) - 1
    accessor.pop("byteOffset", None)
