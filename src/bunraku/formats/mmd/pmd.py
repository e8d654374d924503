"""Read PMD, the older models of MikuMikuDance: mesh, materials, bones, rigid bodies and joints.

PMD knows kinds of bones where PMX says what they depend on, and its knees are known by their names.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdAppend, MmdBone, MmdIk, MmdIkLink, MmdMorph, mmd_angles, mmd_points
from bunraku.formats.mmd.build import MAX_BODIES, MAX_BONES, MAX_JOINTS, MmdFile, MmdMaterial, mmd_character
from bunraku.formats.mmd.physics import read_body, read_joint
from bunraku.formats.mmd.reader import MmdReader

__all__ = ["read_pmd"]

_VERTEX = np.dtype(
    [
        ("position", "<f4", 3),
        ("normal", "<f4", 3),
        ("uv", "<f4", 2),
        ("bones", "<u2", 2),
        ("weight", "u1"),
        ("edge", "u1"),
    ]
)
_NONE = 0xFFFF
_TURNS_AND_MOVES, _IK, _TURNS_WITH, _TWIST, _TURNS_PARTLY = 1, 2, 5, 8, 9  # kinds of bones
_STILL = (6, 7)  # targets of inverse kinematics, and hidden ones
_KNEE = np.radians([[-180.0, 0, 0], [-0.5, 0, 0]])


def read_pmd(path: Path, data: bytes) -> Character:
    """Read a PMD file.

    Args:
        path: The file; textures are looked for in its folder and below, nowhere else.
        data: Its bytes.

    Raises:
        FormatError: It is no PMD file, is cut off, announces more than it has room for, or has indices that point
            outside.
        CharacterError: What it holds is no character.
    """
    return mmd_character(path, read_pmd_file(path, data))


def read_pmd_file(path: Path, data: bytes) -> MmdFile:
    """What a PMD file says, its indices not checked.

    Raises:
        FormatError: It is no PMD file, is cut off, or announces more than it has room for.
    """
    reader = MmdReader(path, data)
    if reader.take(3) != b"Pmd":
        reader.fail("it does not begin with 'Pmd', so it is no PMD file")
    reader.skip(4)  # version
    out = MmdFile("PMD", reader.field(20))
    reader.skip(256)
    _mesh(reader, out)
    out.materials = [_material(reader) for _ in range(reader.count("materials", 70, "I"))]
    count = reader.count("bones", 39, "H")
    if count > MAX_BONES:
        reader.fail(f"it has {count:,} bones, and at most {MAX_BONES:,} are read")
    raw = [_bone(reader, out, index) for index in range(count)]
    out.bones = [_twisting(bone, out.tails.get(index, -1), kind, raw) for index, (bone, kind) in enumerate(raw)]
    _inverse_kinematics(reader, out)
    for _ in range(reader.count("morphs", 25, "H")):
        name, offsets, _ = reader.field(20), int(reader.one("I")), reader.one("B")
        reader.skip(16 * offsets)
        out.morphs.append(MmdMorph(name, "vertex", offsets))
    groups = _display(reader)
    if reader.left:
        _english(reader, out, groups)
    if reader.left >= 1000:
        reader.skip(1000)  # toon textures
        _physics(reader, out)
    return out


def _mesh(reader: MmdReader, out: MmdFile) -> None:
    vertices = reader.records(_VERTEX, reader.count("vertices", _VERTEX.itemsize, "I"))
    count = len(vertices)
    out.positions, out.normals, out.uvs = (vertices[name].astype(float) for name in ("position", "normal", "uv"))
    share = np.clip(vertices["weight"] / 100.0, 0, 1)
    out.indices, out.weights = np.full((count, 4), -1, np.int64), np.zeros((count, 4))
    out.indices[:, :2] = vertices["bones"]
    out.weights[:, 0], out.weights[:, 1] = share, 1 - share
    out.deforms, out.sdef = np.ones(count, np.uint8), np.zeros((count, 3, 3))
    corners = reader.records(np.dtype("<u2"), reader.count("triangle corners", 2, "I"))
    out.triangles = corners[: len(corners) // 3 * 3].reshape(-1, 3).astype(np.int64)


def _material(reader: MmdReader) -> MmdMaterial:
    diffuse = reader.floats(4)
    reader.skip(16)  # shininess and specular
    ambient = reader.floats(3)
    reader.skip(2)  # toon and edge
    corners = int(reader.one("I"))
    texture = next((part for part in reader.field(20).split("*") if not part.lower().endswith((".sph", ".spa"))), "")
    return MmdMaterial("material", diffuse, ambient, bool(diffuse[3] < 1), texture, corners)


def _bone(reader: MmdReader, out: MmdFile, index: int) -> tuple[MmdBone, int]:
    """A bone with its kind."""
    name = reader.field(20)
    parent, tail, kind, other = reader.values("HHBH")
    position = mmd_points(reader.floats(3))
    out.tails[index] = tail if tail not in (0, _NONE) else -1  # 0 and none both say that there is no tail
    append = None
    if kind == _TURNS_WITH and other != _NONE:
        append = MmdAppend(other, 1.0, True, False)
    elif kind == _TURNS_PARTLY:
        append = MmdAppend(tail, float(np.int16(np.uint16(other))) / 100, True, False)
        out.tails[index] = -1
    bone = MmdBone(
        name, "", position, -1 if parent == _NONE else parent, rotates=kind not in _STILL,
        moves=kind in (_TURNS_AND_MOVES, _IK), append=append
    )  # fmt: skip
    return bone, int(kind)


def _twisting(bone: MmdBone, tail: int, kind: int, bones: list[tuple[MmdBone, int]]) -> MmdBone:
    """The bone; one that twists turns only about the line to its tail."""
    if kind != _TWIST or not 0 <= tail < len(bones):
        return bone
    line = bones[tail][0].position - bone.position
    length = float(np.linalg.norm(line))
    return replace(bone, fixed_axis=line / length) if length > 1e-9 else bone


def _inverse_kinematics(reader: MmdReader, out: MmdFile) -> None:
    for _ in range(reader.count("inverse kinematics", 11, "H")):
        goal, target, links, loops, limit = reader.values("HHBHf")
        chain = [_link(int(bone), out) for bone in reader.values(f"{links}H")]
        if goal >= len(out.bones):
            out.note("inverse kinematics are of bones that do not exist and are left out", f"bone {goal}")
            continue
        out.bones[goal] = replace(
            out.bones[goal], layer=1, ik=MmdIk(int(target), int(loops), 4.0 * limit, tuple(chain))
        )


def _link(bone: int, out: MmdFile) -> MmdIkLink:
    knee = bone < len(out.bones) and "ひざ" in out.bones[bone].name
    return MmdIkLink(bone, *mmd_angles(*_KNEE)) if knee else MmdIkLink(bone)


def _display(reader: MmdReader) -> int:
    """Pass over what editors show, and tell how many groups of bones there are."""
    reader.skip(2 * reader.count("shown morphs", 2, "B"))
    groups = reader.count("groups of bones", 50, "B")
    reader.skip(50 * groups)
    reader.skip(3 * reader.count("shown bones", 3, "I"))
    return groups


def _english(reader: MmdReader, out: MmdFile, groups: int) -> None:
    reader.section = "English names"
    if not reader.one("B"):
        return
    out.english = reader.field(20)
    reader.skip(256)
    out.bones = [replace(bone, english=reader.field(20)) for bone in out.bones]
    reader.skip(20 * max(len(out.morphs) - 1, 0) + 50 * groups)


def _physics(reader: MmdReader, out: MmdFile) -> None:
    if not reader.left:
        return
    bodies = reader.count("rigid bodies", 83, "I")
    if bodies > MAX_BODIES:
        out.note(f"its {bodies:,} rigid bodies are left out, at most {MAX_BODIES:,} are read")
        return
    for _ in range(bodies):
        name, bone = reader.field(20), int(reader.one("H"))
        bone = -1 if bone == _NONE else bone
        origin = (
            out.bones[max(bone, 0)].position if max(bone, 0) < len(out.bones) else np.zeros(3)
        )  # those on no bone stand at the first
        out.bodies.append(read_body(reader, name, bone, origin))
    joints = reader.count("joints", 124, "I")
    if joints > MAX_JOINTS:
        out.note(f"its {joints:,} joints are left out, at most {MAX_JOINTS:,} are read")
        return
    for _ in range(joints):
        name, first, second = reader.field(20), reader.one("I"), reader.one("I")
        out.joints.append(read_joint(reader, name, (first, second)))
