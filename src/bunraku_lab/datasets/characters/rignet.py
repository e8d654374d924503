"""Read the rigged characters of ModelsResource-RigNet: an OBJ, and a text with its joints, their tree and the skin.

The text has lines `joints NAME X Y Z`, `root NAME`, `hier PARENT CHILD` and `skin VERTEX JOINT WEIGHT JOINT WEIGHT
...`, with vertices counted from 0. It lies beside the OBJ as `NAME_rig.txt`, or, as in the published archive, in a
folder `rig_info` (or `rig_info_remesh`) beside the folder `obj` (or `obj_remesh`) of the mesh, as `NAME.txt`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from bunraku.core.character import Character, Rig
from bunraku.errors import FormatError
from bunraku.formats.files import MAX_BYTES, check_text, read_bounded
from bunraku.formats.skins import borrow_weights, strongest
from bunraku.io import load_character
from bunraku.io.units import in_metres

__all__ = ["find_rig", "load_rigged"]

MAX_JOINTS, MAX_SHARES, INFLUENCES = 10_000, 50_000_000, 16
_SUFFIXES = ("", "_remesh", "_ori")
_FIX = "correct the line or take the file from the archive again"


@dataclass(frozen=True)
class _Text:
    """What a rig text says, checked."""

    names: tuple[str, ...]
    positions: np.ndarray  # (J, 3)
    parents: np.ndarray  # (J,)
    vertices: np.ndarray  # (S,), of each share
    joints: np.ndarray  # (S,)
    shares: np.ndarray  # (S,)
    lines: int  # how many vertices have a skin line


def load_rigged(path: Path, *, rest: str = "bind") -> Character:
    """Read a character, an OBJ with the rig of the text that belongs to it where there is one.

    Args:
        path: The file, of any format of `bunraku.load_character`.
        rest: As for `bunraku.load_character`.

    Raises:
        FormatError: The file or the rig text is broken.
        CharacterError: The mesh is no character.
    """
    rig = find_rig(path) if path.suffix.lower() == ".obj" else None
    if rig is None:
        return load_character(path, rest=rest)
    character = _rigged(load_character(path, unit="m"), _read_text(rig, read_bounded(rig)), rig)
    return in_metres(character, "auto", None)[0]


def find_rig(mesh: Path) -> Path | None:
    """The rig text that belongs to an OBJ, None where there is none."""
    stems = [mesh.stem, *(mesh.stem.removesuffix(suffix) for suffix in _SUFFIXES[1:] if mesh.stem.endswith(suffix))]
    candidates = [mesh.with_name(f"{stem}_rig.txt") for stem in stems]
    if mesh.parent.name.startswith("obj"):
        folder = mesh.parent.parent / f"rig_info{mesh.parent.name.removeprefix('obj')}"
        candidates += [folder / f"{mesh.stem}.txt", folder / f"{mesh.stem}_rig.txt"]
    return next((path for path in candidates if os.path.isfile(path)), None)


def _rigged(character: Character, text: _Text, path: Path) -> Character:
    count = len(character.vertices)
    if len(text.vertices) and int(text.vertices.max()) >= count:
        raise FormatError(
            path,
            f"a skin line is for vertex {int(text.vertices.max())} but the mesh has {count}; take the mesh that "
            "belongs to this rig",
        )
    if 2 * text.lines < count:
        raise FormatError(
            path,
            f"it has skin lines for {text.lines} of the {count} vertices of the mesh; take the mesh that belongs to "
            "this rig",
        )
    indices, weights = strongest(text.vertices, text.joints, text.shares, count, INFLUENCES)
    lost = np.flatnonzero(weights.sum(axis=1) <= 0)
    if len(lost):
        borrow_weights(character.vertices, indices, weights, lost)
    transforms = np.tile(np.eye(4), (len(text.names), 1, 1))
    transforms[:, :3, 3] = text.positions
    rig = Rig(text.names, text.parents, transforms, indices, weights)
    return Character(character.name, character.vertices, character.faces, rig, character.colors, character.source)


class _Reader:
    """Takes the lines of a rig text apart."""

    def __init__(self, path: Path):
        self.path = path
        self.number = 0
        self.joints: dict[str, int] = {}
        self.positions: list[list[float]] = []
        self.links: list[tuple[int, str, str]] = []
        self.roots: list[str] = []
        self.seen: set[int] = set()
        self.vertices: list[int] = []
        self.names: list[str] = []
        self.shares: list[float] = []

    def fail(self, problem: str) -> NoReturn:
        raise FormatError(self.path, f"line {self.number} {problem}; {_FIX}")

    def line(self, words: list[str]) -> None:
        kind = words[0]
        if kind in ("joints", "joint"):
            self._joint(words)
        elif kind == "skin":
            self._skin(words)
        elif kind == "root" and len(words) == 2:
            self.roots.append(words[1])
        elif kind == "hier" and len(words) == 3:
            self.links.append((self.number, words[1], words[2]))
        else:
            self.fail(f"starts with '{kind[:20]}' and has {len(words)} words, which no line of a rig has")

    def _joint(self, words: list[str]) -> None:
        if len(words) != 5:
            self.fail("is no 'joints NAME X Y Z'")
        if words[1] in self.joints:
            self.fail(f"names the joint '{words[1][:40]}' a second time")
        self.joints[words[1]] = len(self.positions)
        self.positions.append([self.decimal(word) for word in words[2:]])
        if len(self.positions) > MAX_JOINTS:
            self.fail(f"is one joint more than {MAX_JOINTS:,}")

    def _skin(self, words: list[str]) -> None:
        if len(words) < 4 or len(words) % 2:
            self.fail("is no 'skin VERTEX JOINT WEIGHT ...'")
        if not words[1].isdecimal() or len(words[1]) > 10:
            self.fail(f"weighs the vertex '{words[1][:20]}', which is no number")
        vertex = int(words[1])
        if vertex in self.seen:
            self.fail(f"weighs vertex {vertex} a second time")
        self.seen.add(vertex)
        for name, share in zip(words[2::2], words[3::2], strict=True):
            self.vertices.append(vertex)
            self.names.append(name)
            self.shares.append(self.decimal(share))
        if len(self.shares) > MAX_SHARES:
            self.fail(f"makes more than {MAX_SHARES:,} weights")

    def decimal(self, word: str) -> float:
        try:
            value = float(word) if len(word) <= 64 else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > 1e12:
            self.fail(f"holds '{word[:20]}', which is no number")
        return value


def _read_text(path: Path, data: bytes) -> _Text:
    check_text(path, data)
    if len(data) > MAX_BYTES or b"\0" in data[:4096]:
        raise FormatError(path, "this is not a rig text, it holds binary data; check its suffix")
    reader = _Reader(path)
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if words:
            reader.number = number
            reader.line(words)
    if not reader.joints:
        raise FormatError(
            path,
            "it has no joints; a rig has lines 'joints NAME X Y Z', 'root NAME', 'hier PARENT CHILD' and 'skin ...'",
        )
    if not reader.shares:
        raise FormatError(path, f"it has no skin lines; {_FIX}")
    unknown = next((name for name in reader.names if name not in reader.joints), None)
    if unknown is not None:
        raise FormatError(path, f"a skin line names the joint '{unknown[:40]}', which has no 'joints' line; {_FIX}")
    joints = np.fromiter((reader.joints[name] for name in reader.names), np.int64, len(reader.names))
    shares = np.maximum(np.array(reader.shares), 0)
    vertices = np.array(reader.vertices, np.int64)
    return _Text(
        tuple(reader.joints),
        np.array(reader.positions),
        _parents(path, reader),
        vertices,
        joints,
        shares,
        len(reader.seen),
    )


def _parents(path: Path, reader: _Reader) -> np.ndarray:
    """Parent of each joint, checked to be one tree below the root, shape (J,)."""
    parents = np.full(len(reader.joints), -1)
    for number, parent, child in reader.links:
        reader.number = number
        for name in (parent, child):
            if name not in reader.joints:
                reader.fail(f"names the joint '{name[:40]}', which has no 'joints' line")
        if parents[reader.joints[child]] >= 0:
            reader.fail(f"gives the joint '{child[:40]}' a second parent")
        parents[reader.joints[child]] = reader.joints[parent]
    if len(reader.roots) != 1 or reader.roots[0] not in reader.joints:
        raise FormatError(
            path, f"it needs one line 'root NAME' that names one of its joints, and has {len(reader.roots)}; {_FIX}"
        )
    names, root = list(reader.joints), reader.joints[reader.roots[0]]
    if parents[root] >= 0:
        raise FormatError(path, f"its root '{names[root][:40]}' has a parent; {_FIX}")
    reached = {root}
    children: dict[int, list[int]] = {}
    for joint, parent_joint in enumerate(parents):
        children.setdefault(int(parent_joint), []).append(joint)
    stack = [root]
    while stack:
        below = children.get(stack.pop(), [])
        reached.update(below)
        stack += below
    lost = next((name for joint, name in enumerate(names) if joint not in reached), None)
    if lost is not None:
        raise FormatError(
            path, f"its 'hier' lines do not lead from the root to the joint '{lost[:40]}', or go in a loop; {_FIX}"
        )
    return parents
