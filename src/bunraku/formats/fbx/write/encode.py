"""The bytes of a binary FBX file: elements with values and children.

The file format has no public specification. What is here is what readers ask for: offsets of the ends of elements,
arrays that zlib packs, an empty record behind the last child, and a footer with fixed numbers, which Autodesk's readers
compare with the time of creation, so that one is fixed too.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

__all__ = ["CREATION_TIME", "FILE_ID", "VERSION", "Element", "element", "prop", "properties", "write_elements"]

VERSION = 7400
FILE_ID = bytes.fromhex("28b32aebb624ccc2bfc8b02aa92bfcf1")
CREATION_TIME = "1970-01-01 10:00:00:000"
_MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
_FOOTER_ID = bytes.fromhex("fabcab09d0c8d466b176fb831cf7267e")
_FOOTER_END = bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")
_HEADER = struct.Struct("<IIIB")
_RECORD_END = bytes(_HEADER.size)
_ALWAYS_OPEN = ("AnimationStack", "AnimationLayer", "References")
"""Elements that end with an empty record whether they have children or not."""
_ARRAYS = {"float64": b"d", "float32": b"f", "int32": b"i", "int64": b"l"}
_PACKED_FROM = 128  # bytes

_KINDS: dict[str, tuple[str, str, str]] = {
    "bool": ("bool", "", ""), "int": ("int", "Integer", ""), "enum": ("enum", "", ""), "string": ("KString", "", ""),
    "double": ("double", "Number", ""), "number": ("Number", "", "A"), "color": ("Color", "", "A"),
    "rgb": ("ColorRGB", "Color", ""), "vector": ("Vector3D", "Vector", ""), "time": ("KTime", "Time", ""),
    "object": ("object", "", ""), "url": ("KString", "XRefUrl", ""),
    "Lcl Translation": ("Lcl Translation", "", "A"), "Lcl Rotation": ("Lcl Rotation", "", "A"),
    "Lcl Scaling": ("Lcl Scaling", "", "A"),
}  # fmt: skip


@dataclass
class Element:
    """An element.

    Args:
        name: Its name.
        values: Booleans, whole numbers (32 bits; `numpy.int64` for 64), floats, text, bytes and arrays.
        children: Elements below it.
    """

    name: str
    values: list[Any] = field(default_factory=list)
    children: list[Element] = field(default_factory=list)


def element(name: str, *values: Any, children: Sequence[Element] = ()) -> Element:
    """An element of these values and children."""
    return Element(name, list(values), list(children))


def prop(name: str, kind: str, *values: Any) -> Element:
    """A property of an object.

    Args:
        name: Its name.
        kind: One of those that properties here have.
        values: Of that kind.
    """
    return element("P", name, *_KINDS[kind], *values)


def properties(*entries: Element) -> Element:
    """The properties of an object."""
    return element("Properties70", children=entries)


def write_elements(file: BinaryIO, elements: Sequence[Element]) -> None:
    """Write a file of some elements.

    Raises:
        ValueError: It would have more than 4 GiB.
    """
    out = bytearray(_MAGIC + struct.pack("<I", VERSION))
    for one in elements:
        _append(out, one)
        if len(out) > 0xFFFFFFFF:
            raise ValueError("the FBX would have more than 4 GiB")
    out += _RECORD_END + _FOOTER_ID + bytes(4)
    out += bytes(16 - len(out) % 16)
    out += struct.pack("<I", VERSION) + bytes(120) + _FOOTER_END
    file.write(out)


def _append(out: bytearray, one: Element) -> None:
    start, name = len(out), one.name.encode()
    out += _RECORD_END + name
    before = len(out)
    for value in one.values:
        _append_value(out, value)
    length = len(out) - before
    for child in one.children:
        _append(out, child)
    if one.children or not one.values or one.name in _ALWAYS_OPEN:
        out += _RECORD_END
    if len(out) <= 0xFFFFFFFF:
        _HEADER.pack_into(out, start, len(out), len(one.values), length, len(name))


def _append_value(out: bytearray, value: Any) -> None:
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value).tobytes()
        packed = len(data) >= _PACKED_FROM
        stored = zlib.compress(data, 1) if packed else data
        out += _ARRAYS[value.dtype.name] + struct.pack("<III", value.size, int(packed), len(stored)) + stored
    elif isinstance(value, bool):
        out += b"C" + struct.pack("<b", value)
    elif isinstance(value, np.int64):
        out += b"L" + struct.pack("<q", value)
    elif isinstance(value, int):
        out += b"I" + struct.pack("<i", value)
    elif isinstance(value, float):
        out += b"D" + struct.pack("<d", value)
    else:
        data = value.encode() if isinstance(value, str) else bytes(value)
        out += (b"S" if isinstance(value, str) else b"R") + struct.pack("<I", len(data)) + data
