"""The HIERARCHY part of a BVH file: joints, their offsets, and which columns of the motion are theirs."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

from bunraku.errors import FormatError

__all__ = ["BvhJoint", "parse_hierarchy"]

MOST_JOINTS = 4096
MOST_CHANNELS = 9
_WORDS = re.compile(
    r"(?:ROOT|JOINT)\b[ \t]*(?P<joint>[^\r\n{}]*)|(?P<end>END[ \t]+SITE)\b[^\r\n{}]*|(?P<open>\{)|(?P<close>\})"
    r"|OFFSETS?\b[ \t]*(?P<offset>[^\r\n{}]*)"
    r"|CHANNELS\b\s*(?P<channels>\d{1,18}\b(?:\s+[XYZ](?:position|rotation|scale)\b)*)|(?P<other>\S+)",
    re.IGNORECASE,
)


@dataclass
class BvhJoint:
    """A joint, or the end of one.

    Args:
        name: Its name; empty for an end site.
        parent: Index of its parent, -1 for a root.
        offset: From the parent's, in the file's unit.
        channels: (axis, "position" or "rotation" or "scale", column) in the order of the file.
    """

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: list[tuple[int, str, int]] = field(default_factory=list)


def parse_hierarchy(path: Path, text: str) -> tuple[list[BvhJoint], int]:
    """Joints and end sites in the order of the file, parents first, and the number of columns of the motion.

    Raises:
        FormatError: The text breaks the grammar, holds a joint inside itself, or has too many joints.
    """
    text = text.removeprefix("\ufeff").strip()
    if not re.match(r"HIERARCHY\b", text, re.IGNORECASE):
        raise FormatError(path, "it does not begin with HIERARCHY, so it is no BVH file; export it again")
    joints: list[BvhJoint] = []
    above: list[int] = []  # open braces
    names: dict[str, int] = {}
    inside: list[str] = []  # names as they are in the file, of the joints in `above`
    columns, waiting = 0, False
    for word in _WORDS.finditer(text, len("HIERARCHY")):
        kind = word.lastgroup
        here = joints[above[-1]] if above else None
        if kind in ("joint", "end"):
            name = (word["joint"] or "").strip()
            if waiting or (kind == "end" and here is None):
                raise FormatError(path, f"its hierarchy has no braces before {name or 'an end site'}; export it again")
            if kind == "joint" and name in inside:
                raise FormatError(
                    path, f"its joint '{name}' is inside itself, a cycle; give every joint a name of its own"
                )
            if len(joints) >= MOST_JOINTS:
                raise FormatError(path, f"it has more than {MOST_JOINTS} joints; export the skeleton without its props")
            joints.append(
                BvhJoint(_unique(name or "joint", names) if kind == "joint" else "", above[-1] if above else -1)
            )
            inside.append(name)
            waiting = True
        elif kind == "open" and waiting:
            above.append(len(joints) - 1)
            waiting = False
        elif kind == "close" and above and not waiting:
            above.pop()
            inside.pop()
        elif kind == "offset" and here is not None:
            here.offset = _offset(path, word["offset"], here.name)
        elif kind == "channels" and here is not None and here.name and not here.channels:
            count, *kinds = word["channels"].lower().split()
            if int(count) != len(kinds) or len(kinds) > MOST_CHANNELS:
                raise FormatError(
                    path, f"its joint '{here.name}' announces {count} channels and names {len(kinds)}; export it again"
                )
            here.channels = [
                ("xyz".index(channel[0]), channel[1:], columns + index) for index, channel in enumerate(kinds)
            ]
            columns += len(kinds)
        else:
            raise FormatError(
                path, f"its hierarchy has '{word[0].strip()[:40]}' where it makes no sense; export it again"
            )
    if above or waiting:
        raise FormatError(path, "its hierarchy is cut off: braces are open at its end; export it again")
    if not any(joint.name for joint in joints):
        raise FormatError(path, "its hierarchy holds no joint; export it with its skeleton")
    return joints, columns


def _unique(name: str, names: dict[str, int]) -> str:
    """The name, with a number where another joint has it."""
    while True:
        names[name] = names.get(name, 0) + 1
        if names[name] == 1:
            return name
        name = f"{name}_{names[name]}"


def _offset(path: Path, words: str, name: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in words.split())
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise FormatError(
            path, f"the offset of its joint '{name}' is '{words.strip()[:40]}', not three numbers; export it again"
        )
    return x, y, z
