"""FBX files written value by value, binary and text, for tests; nothing here is shared with the reader."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

Node = tuple[str, list[Any], list[Any]]
SECOND = 46_186_158_000
HEAD = b"Kaydara FBX Binary  \x00\x1a\x00"


def node(name: str, *values: Any, children: list[Node] | None = None) -> Node:
    """A node; arrays are numpy arrays."""
    return name, list(values), children or []


def properties(**entries: Any) -> Node:
    """A Properties70 node; `Lcl_Rotation=(1, 2, 3)` names the property `Lcl Rotation`, `d_bar_X` `d|X`."""
    rows = []
    for key, value in entries.items():
        numbers = value if isinstance(value, tuple) else (value,)
        rows.append(
            node(
                "P",
                key.replace("_bar_", "|").replace("_", " ") if key.startswith(("Lcl", "d_bar")) else key,
                "",
                "",
                "A",
                *numbers,
            )
        )
    return node("Properties70", children=rows)


def binary(nodes: list[Node], version: int = 7400, packed: bool = True) -> bytes:
    """A binary FBX file."""
    out = bytearray(HEAD + struct.pack("<I", version))
    for entry in nodes:
        _write(out, entry, version >= 7500, packed)
    return bytes(out + bytes(25 if version >= 7500 else 13) + b"the end, whatever it is")


def _write(out: bytearray, entry: Node, wide: bool, packed: bool) -> None:
    name, values, children = entry
    start, header = len(out), struct.Struct("<QQQB" if wide else "<IIIB")
    body = b"".join(_value(value, packed) for value in values)
    out += bytes(header.size) + name.encode() + body
    for child in children:
        _write(out, child, wide, packed)
    if children or not values:
        out += bytes(header.size)
    header.pack_into(out, start, len(out), len(values), len(body), len(name))


def _value(value: Any, packed: bool) -> bytes:
    if isinstance(value, np.ndarray):
        kind = {"float64": b"d", "float32": b"f", "int32": b"i", "int64": b"l"}[value.dtype.name]
        data = value.tobytes()
        stored = zlib.compress(data) if packed else data
        return kind + struct.pack("<III", value.size, int(packed), len(stored)) + stored
    if isinstance(value, bool):
        return b"C" + struct.pack("<b", value)
    if isinstance(value, int):
        return b"L" + struct.pack("<q", value)
    if isinstance(value, float):
        return b"D" + struct.pack("<d", value)
    data = value.encode() if isinstance(value, str) else value
    return (b"S" if isinstance(value, str) else b"R") + struct.pack("<I", len(data)) + data


def text(nodes: list[Node], version: int = 7400) -> bytes:
    """The same as a text FBX file; names of objects are written the other way round, as there."""
    lines = [
        f"; FBX {version / 1000:.1f} project file",
        "; by hand",
        f"FBXHeaderExtension:  {{\n\tFBXVersion: {version}\n}}",
    ]
    for entry in nodes:
        _lines(lines, entry, "")
    return "\n".join(lines).encode() + b"\n"


def _lines(lines: list[str], entry: Node, indent: str) -> None:
    name, values, children = entry
    if len(values) == 1 and isinstance(values[0], np.ndarray):
        numbers = ",".join(repr(number) for number in values[0].tolist())
        lines.append(f"{indent}{name}: *{values[0].size} {{\n{indent}\ta: {numbers}\n{indent}}} ")
        return
    lines.append(f"{indent}{name}: {', '.join(_word(value) for value in values)}{' {' if children else ''}")
    for child in children:
        _lines(lines, child, indent + "\t")
    if children:
        lines.append(f"{indent}}}")


def _word(value: Any) -> str:
    if isinstance(value, str):
        parts = value.split("\x00\x01")
        return '"' + "::".join(reversed(parts)) + '"'
    return repr(value)


class Scene:
    """Objects and connections of a file to be."""

    def __init__(self, **settings: Any):
        self.settings = settings
        self.objects: list[Node] = []
        self.links: list[Node] = []
        self.next = 100

    def add(
        self, kind: str, name: str, subtype: str, *children: Node, below: int | None = None, drives: str = ""
    ) -> int:
        """Add an object, connect it below another and return its number."""
        self.next += 1
        label = {
            "AnimationStack": "AnimStack",
            "AnimationLayer": "AnimLayer",
            "AnimationCurveNode": "AnimCurveNode",
            "AnimationCurve": "AnimCurve",
        }
        self.objects.append(
            node(kind, self.next, f"{name}\x00\x01{label.get(kind, kind)}", subtype, children=list(children))
        )
        if below is not None:
            self.link(self.next, below, drives)
        return self.next

    def link(self, child: int, owner: int, drives: str = "") -> None:
        self.links.append(node("C", "OP" if drives else "OO", child, owner, *([drives] if drives else [])))

    def model(self, name: str, kind: str = "LimbNode", below: int = 0, **entries: Any) -> int:
        return self.add("Model", name, kind, properties(**entries), below=below)

    def mesh(self, model: int, points: Any, polygons: list[list[int]], *layers: Node) -> int:
        """Add a mesh below a model and return its number."""
        corners = [
            corner if i + 1 < len(polygon) else ~corner for polygon in polygons for i, corner in enumerate(polygon)
        ]
        arrays = (
            node("Vertices", np.array(points, float).reshape(-1)),
            node("PolygonVertexIndex", np.array(corners, np.int32)),
        )
        return self.add("Geometry", "Mesh", "Mesh", *arrays, *layers, below=model)

    def skin(self, mesh: int) -> int:
        return self.add("Deformer", "Skin", "Skin", below=mesh)

    def cluster(self, skin: int, joint: int, index: Any, weights: Any, transform: np.ndarray, bind: np.ndarray) -> int:
        made = self.add(
            "Deformer", "", "Cluster",
            node("Indexes", np.array(index, np.int32)), node("Weights", np.array(weights, float)),
            node("Transform", transform.T.reshape(-1).copy()), node("TransformLink", bind.T.reshape(-1).copy()),
            below=skin,
        )  # fmt: skip
        self.link(joint, made)
        return made

    def clip(self, name: str = "Take") -> int:
        """Add a clip and return the number of its layer."""
        return self.add("AnimationLayer", "Base", "", below=self.add("AnimationStack", name, "", properties()))

    def track(self, layer: int, model: int, what: str, **axes: tuple[Any, ...]) -> int:
        """Animate a property: for an axis (times, values) or (times, values, flags, data of four floats a key)."""
        group = self.add("AnimationCurveNode", what[4], "", properties(), below=layer)
        self.link(group, model, what)
        for axis, (times, values, *more) in axes.items():
            entries = [
                node("KeyTime", np.round(np.array(times, float) * SECOND).astype(np.int64)),
                node("KeyValueFloat", np.array(values, np.float32)),
            ]
            flags, data = more if more else ([4] * len(times), [[0, 0, 0, 0]] * len(times))
            entries += [
                node("KeyAttrFlags", np.array(flags, np.int32)),
                node("KeyAttrDataFloat", np.array(data, np.float32).reshape(-1)),
                node("KeyAttrRefCount", np.ones(len(times), np.int32)),
            ]
            self.add("AnimationCurve", "", "", *entries, below=group, drives=f"d|{axis}")
        return group

    def nodes(self) -> list[Node]:
        out = [node("GlobalSettings", children=[properties(**self.settings)])] if self.settings else []
        return [*out, node("Objects", children=self.objects), node("Connections", children=self.links)]
