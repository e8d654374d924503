"""The bytes of a binary FBX file: elements, objects, their connections, and the file around them."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from bunraku.core.geometry.axes import UNITS, FileFrame
from bunraku.files.gltf.carry import free_name

VERSION = 7400
FILE_ID = bytes.fromhex("28b32aebb624ccc2bfc8b02aa92bfcf1")
CREATION_TIME = "1970-01-01 10:00:00:000"
_MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
_FOOTER_ID = bytes.fromhex("fabcab09d0c8d466b176fb831cf7267e")
_FOOTER_END = bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")
_HEADER = struct.Struct("<IIIB")
_RECORD_END = bytes(_HEADER.size)
_ALWAYS_OPEN = ("AnimationStack", "AnimationLayer", "References")
"""Elements that end with an empty record, with or without children."""
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
    """An element."""

    name: str
    # Booleans, integers (32 bits; `numpy.int64` for 64), floats, text, bytes and arrays.
    values: list[Any] = field(default_factory=list)
    children: list[Element] = field(default_factory=list)  # elements below it


def element(name: str, *values: Any, children: Sequence[Element] = ()) -> Element:
    """An element of these values and children."""
    return Element(name, list(values), list(children))


def prop(name: str, kind: str, *values: Any) -> Element:
    """A property of an object: its name, one of the kinds of `_KINDS`, and values of that kind."""
    return element("P", name, *_KINDS[kind], *values)


def properties(*entries: Element) -> Element:
    """The properties of an object."""
    return element("Properties70", children=entries)


def write_elements(file: BinaryIO, elements: Sequence[Element]) -> None:
    """Write a file of some elements. ValueError if it would have more than 4 GiB."""
    out = bytearray(_MAGIC + struct.pack("<I", VERSION))
    for element in elements:
        _append(out, element)
        if len(out) > 0xFFFFFFFF:
            raise ValueError("the FBX would have more than 4 GiB")
    out += _RECORD_END + _FOOTER_ID + bytes(4)
    out += bytes(16 - len(out) % 16)
    out += struct.pack("<I", VERSION) + bytes(120) + _FOOTER_END
    file.write(out)


def _append(out: bytearray, one: Element) -> None:
    start, name = len(out), one.name.encode("utf-8", "replace")
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
        data = value.encode("utf-8", "replace") if isinstance(value, str) else bytes(value)
        out += (b"S" if isinstance(value, str) else b"R") + struct.pack("<I", len(data)) + data


SECOND = 46_186_158_000
"""Ticks of an FBX clock in a second."""
_CLASSES = {
    "AnimationStack": "AnimStack", "AnimationLayer": "AnimLayer", "AnimationCurveNode": "AnimCurveNode",
    "AnimationCurve": "AnimCurve",
}  # fmt: skip
_RATES = {120.0: 1, 100.0: 2, 60.0: 3, 50.0: 4, 48.0: 5, 30.0: 6, 25.0: 10, 24.0: 11, 1000.0: 12}
_OTHER_RATE = 14
_FIRST_ID = 1_000_000


@dataclass(frozen=True)
class Span:
    """A clip in the list of the file: its name and last moment [ticks]."""

    name: str
    stop: int


@dataclass
class Objects:
    """Objects and connections of a file."""

    frame: FileFrame  # the axes and the unit of the file
    up: str  # the axis that is up in it, "+y" or "+z"
    unit: str  # its unit of length
    spans: list[Span] = field(default_factory=list)
    fps: float = 30.0
    _objects: list[Element] = field(default_factory=list)
    _links: list[Element] = field(default_factory=list)
    _names: dict[str, set[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str, subtype: str = "", *children: Element, label: str | None = None) -> int:
        """Add an object of a kind ("Model", "Geometry" ...), with elements below it, and return its number; `label`
        follows its name where that is not the kind.
        """
        number = _FIRST_ID + len(self._objects)
        title = f"{name}\x00\x01{label or _CLASSES.get(kind, kind)}"
        self._objects.append(element(kind, np.int64(number), title, subtype, children=children))
        return number

    def link(self, child: int, parent: int, drives: str = "") -> None:
        """Connect an object to another, or to a property of it; 0 is the scene."""
        ends = np.int64(child), np.int64(parent)
        self._links.append(element("C", "OP", *ends, drives) if drives else element("C", "OO", *ends))

    def free_name(self, name: str, among: str) -> str:
        """A name that nothing else of a kind has: with a number where it is taken."""
        taken = self._names.setdefault(among, set())
        taken.add(chosen := free_name(name.replace("\x00", " "), taken, "_", 1))
        return chosen

    def elements(self) -> list[Element]:
        """The whole file."""
        scene = np.int64(_FIRST_ID - 1)
        stop = max((span.stop for span in self.spans), default=SECOND)
        active = self.spans[0].name if self.spans else ""
        document = [
            properties(prop("SourceObject", "object"), prop("ActiveAnimStackName", "string", active)),
            element("RootNode", np.int64(0)),
        ]
        return [
            element("FBXHeaderExtension", children=[
                element("FBXHeaderVersion", 1003), element("FBXVersion", VERSION), element("EncryptionType", 0),
                element("CreationTimeStamp", children=[
                    element("Version", 1000),
                    *(element(part, value) for part, value in (("Year", 1970), ("Month", 1), ("Day", 1), ("Hour", 10),
                                                               ("Minute", 0), ("Second", 0), ("Millisecond", 0))),
                ]),
                element("Creator", "bunraku"),
            ]),
            element("FileId", FILE_ID), element("CreationTime", CREATION_TIME), element("Creator", "bunraku"),
            element("GlobalSettings", children=[element("Version", 1000), self._settings(stop)]),
            element("Documents", children=[
                element("Count", 1), element("Document", scene, "Scene", "Scene", children=document),
            ]),
            element("References"),
            element("Definitions", children=self._definitions()),
            element("Objects", children=self._objects),
            element("Connections", children=self._links),
            element("Takes", children=[element("Current", active), *map(_take, self.spans)]),
        ]  # fmt: skip

    def _settings(self, stop: int) -> Element:
        vertical, front, sign = (1, 2, 1) if self.up == "+y" else (2, 1, -1)
        scale = 100 * UNITS[self.unit]
        rate = next((code for rate_of_code, code in _RATES.items() if abs(rate_of_code - self.fps) < 1e-6), _OTHER_RATE)
        return properties(
            prop("UpAxis", "int", vertical), prop("UpAxisSign", "int", 1),
            prop("FrontAxis", "int", front), prop("FrontAxisSign", "int", sign),
            prop("CoordAxis", "int", 0), prop("CoordAxisSign", "int", 1),
            prop("OriginalUpAxis", "int", vertical), prop("OriginalUpAxisSign", "int", 1),
            prop("UnitScaleFactor", "double", scale), prop("OriginalUnitScaleFactor", "double", scale),
            prop("AmbientColor", "rgb", 0.0, 0.0, 0.0), prop("DefaultCamera", "string", "Producer Perspective"),
            prop("TimeMode", "enum", rate), prop("TimeSpanStart", "time", np.int64(0)),
            prop("TimeSpanStop", "time", np.int64(stop)), prop("CustomFrameRate", "double", float(self.fps)),
        )  # fmt: skip

    def _definitions(self) -> list[Element]:
        counts = Counter(entry.name for entry in self._objects)
        types = [element("ObjectType", name, children=[element("Count", count)]) for name, count in counts.items()]
        settings = element("ObjectType", "GlobalSettings", children=[element("Count", 1)])
        return [element("Version", 100), element("Count", 1 + len(self._objects)), settings, *types]


def _take(span: Span) -> Element:
    ends = np.int64(0), np.int64(span.stop)
    return element("Take", span.name, children=[
        element("FileName", f"{span.name}.tak"), element("LocalTime", *ends), element("ReferenceTime", *ends),
    ])  # fmt: skip
