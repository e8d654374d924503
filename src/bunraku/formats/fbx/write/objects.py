"""The objects of an FBX file that is written, what hangs on what, and the file around them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from bunraku.formats.fbx.write.encode import CREATION_TIME, FILE_ID, VERSION, Element, element, prop, properties
from bunraku.formats.frames import UNITS, FileFrame

__all__ = ["SECOND", "Objects", "Span"]

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
    """A clip as the file lists it.

    Args:
        name: Its name.
        stop: Its last moment [ticks].
    """

    name: str
    stop: int


@dataclass
class Objects:
    """Objects and connections of a file.

    Args:
        frame: The axes and the unit of the file.
        up: The axis that is up in it, "+y" or "+z".
        unit: Its unit of length.
    """

    frame: FileFrame
    up: str
    unit: str
    spans: list[Span] = field(default_factory=list)
    fps: float = 30.0
    _objects: list[Element] = field(default_factory=list)
    _links: list[Element] = field(default_factory=list)
    _names: dict[str, set[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str, subtype: str = "", *children: Element, label: str | None = None) -> int:
        """Add an object and return its number.

        Args:
            kind: What it is: "Model", "Geometry" and so on.
            name: Its name.
            subtype: What kind of that it is.
            children: Elements below it.
            label: What stands behind its name, where that is another word than `kind`.
        """
        number = _FIRST_ID + len(self._objects)
        title = f"{name}\x00\x01{label or _CLASSES.get(kind, kind)}"
        self._objects.append(element(kind, np.int64(number), title, subtype, children=children))
        return number

    def link(self, child: int, parent: int, drives: str = "") -> None:
        """Hang an object on another, or on a property of it; 0 is the scene."""
        ends = np.int64(child), np.int64(parent)
        self._links.append(element("C", "OP", *ends, drives) if drives else element("C", "OO", *ends))

    def free_name(self, name: str, among: str) -> str:
        """A name that nothing else of a kind has: with a number where it is taken."""
        taken = self._names.setdefault(among, set())
        name = name.replace("\x00", " ")
        chosen = next(
            one for one in (name, *(f"{name}_{number}" for number in range(1, len(taken) + 2))) if one not in taken
        )
        taken.add(chosen)
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
        rate = next((code for known, code in _RATES.items() if abs(known - self.fps) < 1e-6), _OTHER_RATE)
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
        counts = Counter(one.name for one in self._objects)
        types = [element("ObjectType", name, children=[element("Count", count)]) for name, count in counts.items()]
        settings = element("ObjectType", "GlobalSettings", children=[element("Count", 1)])
        return [element("Version", 100), element("Count", 1 + len(self._objects)), settings, *types]


def _take(span: Span) -> Element:
    ends = np.int64(0), np.int64(span.stop)
    return element("Take", span.name, children=[
        element("FileName", f"{span.name}.tak"), element("LocalTime", *ends), element("ReferenceTime", *ends),
    ])  # fmt: skip
