"""Read PMX 2.0 and 2.1, and the older PMD: the models of MikuMikuDance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.core.avatars import MMD_METRE, MmdAppend, MmdBone, MmdIk, MmdIkLink, MmdMorph, mmd_angles, mmd_points
from bunraku.core.character import Character
from bunraku.files.mmd.model import (
    MAX_BODIES,
    MAX_BONES,
    MAX_JOINTS,
    MmdFile,
    MmdMaterial,
    mmd_character,
    read_body,
    read_joint,
)
from bunraku.files.mmd.vmd import MmdReader

_MORPHS = ("group", "vertex", "bone", "uv", "uv", "uv", "uv", "uv", "material", "flip", "impulse")
_BONES_OF = (1, 2, 4, 2, 4)  # how many bones BDEF1, BDEF2, BDEF4, SDEF and QDEF name
_NUMBERS_OF = (0, 1, 4, 10, 4)  # and how many numbers follow


class _Pmx(MmdReader):
    """A PMX file that is being read: its sizes of indices [bytes], and what it says so far."""

    def __init__(self, path: Path, data: bytes):
        super().__init__(path, data)
        if self.take(4) != b"PMX ":
            self.fail("it does not begin with 'PMX ', so it is no PMX file")
        version = float(self.one("f"))
        if not 1.99 < version < 2.2:
            self.fail(f"it is of version {version:.3g}, and 2.0 and 2.1 are read")
        head = self.take(int(self.one("B")))
        if len(head) < 8 or head[0] > 1 or head[1] > 4 or any(size not in (1, 2, 4) for size in head[2:8]):
            self.fail("its header names sizes that no PMX file has")
        self.encoding = "utf-8" if head[0] else "utf-16-le"
        self.uvs, self.vertex, self.texture, self.material, self.bone, self.morph, self.body = head[1:8]
        self.out = MmdFile(f"PMX {version:.1f}", self.text(), self.text())
        self.textures: list[str] = []

    def named(self) -> str:
        """A name, with its English one passed over."""
        name = self.text()
        self.text()
        return name


def read_model(path: Path, data: bytes) -> Character:
    """Read a PMX or PMD file, by its first bytes; textures are looked for in its folder and below, nowhere else.
    FormatError if it is no such file, is cut off, announces more than it has room for, or has indices that point
    outside; CharacterError if what it holds is no character.
    """
    return mmd_character(path, (read_pmd_file if data.startswith(b"Pmd") else read_pmx_file)(path, data))


def read_pmx_file(path: Path, data: bytes) -> MmdFile:
    """What a PMX file says, its indices not checked. FormatError if it is no PMX file, is cut off, or announces more
    than it has room for.
    """
    reader = _Pmx(path, data)
    reader.text(), reader.text()  # comments
    out, size = reader.out, reader.vertex
    _vertices(reader)
    count = reader.count("triangle corners", size)
    corners = np.frombuffer(reader.take(count * size), {1: "u1", 2: "<u2", 4: "<i4"}[size])
    out.triangles = corners[: count - count % 3].reshape(-1, 3).astype(np.int64)
    reader.textures = [reader.text() for _ in range(reader.count("textures", 4))]
    out.materials = [_material(reader) for _ in range(reader.count("materials", 64 + 4 * 3))]
    count = reader.count("bones", 4 + 4 + 12 + 4 + 2 + 2, most=MAX_BONES)
    out.bones = [_bone(reader, index) for index in range(count)]
    out.morphs = [_morph(reader) for _ in range(reader.count("morphs", 4 + 4 + 2 + 4))]
    for _ in range(reader.count("display frames", 4 + 4 + 1 + 4)):
        reader.named(), reader.one("B")
        for _ in range(int(reader.one("i"))):
            reader.skip(reader.morph if reader.one("B") else reader.bone)
    _physics(reader)
    return out


def _vertices(reader: _Pmx) -> None:
    """Records have five sizes: one pass finds where they start, then those of a kind are read at once."""
    size, head = reader.bone, 32 + 16 * reader.uvs
    count = reader.count("vertices", head + 1 + size + 4)
    length = [head + 1 + bones * size + 4 * numbers + 4 for bones, numbers in zip(_BONES_OF, _NUMBERS_OF, strict=True)]
    data, at, starts, end = reader.data, reader.at, np.empty(count, np.int64), len(reader.data)
    for vertex in range(count):
        starts[vertex] = at
        kind = data[at + head] if at + head < end else 0
        if kind > 4:
            reader.fail(f"vertex {vertex} deforms in a way that PMX does not have")
        at += length[kind]
    if at > end:
        reader.fail("it is cut off in its vertices")
    raw, out, reader.at = np.frombuffer(data, np.uint8), reader.out, at
    fixed = raw[starts[:, None] + np.arange(32)].view("<f4")
    out.positions, out.normals, out.uvs = fixed[:, :3].astype(float), fixed[:, 3:6].astype(float), fixed[:, 6:8]
    out.deforms = raw[starts + head]
    out.indices, out.weights = np.full((count, 4), -1, np.int64), np.zeros((count, 4))
    out.sdef = np.zeros((count, 3, 3))
    integer = {1: "i1", 2: "<i2", 4: "<i4"}[size]
    for kind, (bones, numbers) in enumerate(zip(_BONES_OF, _NUMBERS_OF, strict=True)):
        chosen = np.flatnonzero(out.deforms == kind)
        first = starts[chosen, None] + head + 1
        out.indices[chosen, :bones] = np.ascontiguousarray(raw[first + np.arange(bones * size)]).view(integer)
        stored = raw[first + bones * size + np.arange(4 * numbers)]
        values = np.ascontiguousarray(stored).view("<f4").astype(float)
        if bones == 1:
            out.weights[chosen, 0] = 1
        elif bones == 2:
            out.weights[chosen, 0], out.weights[chosen, 1] = values[:, 0], 1 - values[:, 0]
        else:
            out.weights[chosen] = values
        if kind == 3:
            out.sdef[chosen] = values[:, 1:].reshape(-1, 3, 3)


def _material(reader: _Pmx) -> MmdMaterial:
    name = reader.named() or "material"
    diffuse = reader.floats(4)
    reader.skip(16)  # specular
    ambient = reader.floats(3)
    flags = reader.one("B")
    reader.skip(20)  # edge
    texture = reader.index(reader.texture)
    reader.skip(reader.texture + 1)  # sphere map
    reader.skip(1 if reader.one("B") else reader.texture)  # toon
    reader.text()  # memo
    path = reader.textures[texture] if 0 <= texture < len(reader.textures) else ""
    return MmdMaterial(name, diffuse, ambient, bool(flags & 1), path, int(reader.one("i")))


def _bone(reader: _Pmx, index: int) -> MmdBone:
    size = reader.bone
    name, english = reader.text(), reader.text()
    position = mmd_points(reader.floats(3))
    parent, layer, flags = reader.index(size), int(reader.one("i")), int(reader.one("H"))
    tail = append = local = ik = None
    if flags & 0x1:
        reader.out.tails[index] = reader.index(size)
    else:
        tail = mmd_points(reader.floats(3))
    if flags & 0x300:
        parts = (bool(flags & part) for part in (0x100, 0x200, 0x80))
        append = MmdAppend(reader.index(size), float(reader.one("f")), *parts)
    fixed = mmd_points(reader.floats(3)) / MMD_METRE if flags & 0x400 else None
    if flags & 0x800:
        x, z = mmd_points(reader.floats(3)) / MMD_METRE, -mmd_points(reader.floats(3)) / MMD_METRE
        local = np.stack([x, np.cross(z, x), z])
    if flags & 0x2000:
        reader.skip(4)  # key of an external parent
    if flags & 0x20:
        target, loops, limit = reader.index(size), int(reader.one("i")), float(reader.one("f"))
        links = []
        for _ in range(reader.count("links of inverse kinematics", size + 1)):
            bone = reader.index(size)
            limits = mmd_angles(reader.floats(3), reader.floats(3)) if reader.one("B") else (None, None)
            links.append(MmdIkLink(bone, *limits))
        reader.section = "bones"
        ik = MmdIk(target, loops, limit, tuple(links))
    return MmdBone(
        name, english, position, parent, layer, bool(flags & 0x1000), bool(flags & 0x2), bool(flags & 0x4), tail,
        append, fixed, local, ik
    )  # fmt: skip


def _morph(reader: _Pmx) -> MmdMorph:
    name = reader.named()
    _, kind = reader.values("BB")
    if kind >= len(_MORPHS):
        reader.fail(f"a morph is of kind {kind}, which PMX does not have")
    indices = {"group": reader.morph, "flip": reader.morph, "bone": reader.bone, "material": reader.material,
               "impulse": reader.body}  # fmt: skip
    rest = {"group": 4, "flip": 4, "vertex": 12, "bone": 28, "uv": 16, "material": 1 + 28 * 4, "impulse": 1 + 24}
    role = _MORPHS[kind]
    size = indices.get(role, reader.vertex) + rest[role]
    count = reader.count("offsets of a morph", size)
    reader.skip(count * size)
    reader.section = "morphs"
    return MmdMorph(name, role, count)


def _physics(reader: _Pmx) -> None:
    out, size = reader.out, reader.body

    def add_body() -> None:
        out.bodies.append(read_body(reader, reader.named(), reader.index(reader.bone), np.zeros(3)))

    def add_joint() -> None:
        name, _ = reader.named(), reader.one("B")
        out.joints.append(read_joint(reader, name, (reader.index(size), reader.index(size))))

    sizes = 4 + 4 + reader.bone + 1 + 2 + 1 + 36 + 20 + 1, 4 + 4 + 1 + 2 * size + 96
    _add_physics(reader, out, sizes, "i", (add_body, add_joint))


def _add_physics(
    reader: MmdReader, out: MmdFile, sizes: tuple[int, int], layout: str, add: tuple[Callable[[], None], ...]
) -> None:
    """Read rigid bodies and joints, where there are any, with the functions `add`; more than can be simulated are left
    out, with a warning. `sizes` are the least of a body and of a joint [bytes], `layout` that of their numbers.
    """
    if not reader.left:
        return
    kinds = ("rigid bodies", MAX_BODIES), ("joints", MAX_JOINTS)
    for (kind, most), least, read in zip(kinds, sizes, add, strict=True):
        count = reader.count(kind, least, layout)
        if count > most:
            out.note(f"its {count:,} {kind} are left out, at most {most:,} are read")
            return
        for _ in range(count):
            read()


_VERTEX = np.dtype([
    ("position", "<f4", 3), ("normal", "<f4", 3), ("uv", "<f4", 2), ("bones", "<u2", 2), ("weight", "u1"),
    ("edge", "u1"),
])  # fmt: skip
_NONE = 0xFFFF
_TURNS_AND_MOVES, _IK, _TURNS_WITH, _TWIST, _TURNS_PARTLY = 1, 2, 5, 8, 9  # kinds of bones
_STILL = (6, 7)  # targets of inverse kinematics, and hidden ones
# MMD's own limits of knees, as the standard models' files define them.
_KNEE = np.radians([[-180.0, 0, 0], [-0.5, 0, 0]])


def read_pmd_file(path: Path, data: bytes) -> MmdFile:
    """What a PMD file says, its indices not checked. FormatError if it is no PMD file, is cut off, or announces more
    than it has room for.
    """
    reader = MmdReader(path, data)
    if reader.take(3) != b"Pmd":
        reader.fail("it does not begin with 'Pmd', so it is no PMD file")
    reader.skip(4)  # version
    out = MmdFile("PMD", reader.field(20))
    reader.skip(256)
    _mesh(reader, out)
    out.materials = [_pmd_material(reader) for _ in range(reader.count("materials", 70, "I"))]
    raw = [_pmd_bone(reader, out, index) for index in range(reader.count("bones", 39, "H", MAX_BONES))]
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
        _pmd_physics(reader, out)
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


def _pmd_material(reader: MmdReader) -> MmdMaterial:
    diffuse = reader.floats(4)
    reader.skip(16)  # shininess and specular
    ambient = reader.floats(3)
    reader.skip(2)  # toon and edge
    corners = int(reader.one("I"))
    texture = next((part for part in reader.field(20).split("*") if not part.lower().endswith((".sph", ".spa"))), "")
    return MmdMaterial("material", diffuse, ambient, bool(diffuse[3] < 1), texture, corners)


def _pmd_bone(reader: MmdReader, out: MmdFile, index: int) -> tuple[MmdBone, int]:
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
    """The bone; one that twists rotates only about the line to its tail."""
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
        ik = MmdIk(int(target), int(loops), 4.0 * limit, tuple(chain))
        out.bones[goal] = replace(out.bones[goal], layer=1, ik=ik)


def _link(bone: int, out: MmdFile) -> MmdIkLink:
    knee = bone < len(out.bones) and "ひざ" in out.bones[bone].name
    return MmdIkLink(bone, *mmd_angles(*_KNEE)) if knee else MmdIkLink(bone)


def _display(reader: MmdReader) -> int:
    """Pass over what editors show, and return how many groups of bones there are."""
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


def _pmd_physics(reader: MmdReader, out: MmdFile) -> None:
    def add_body() -> None:
        name, bone = reader.field(20), int(reader.one("H"))
        first = 0 if bone == _NONE else bone  # bodies on no bone stand at the first
        origin = out.bones[first].position if first < len(out.bones) else np.zeros(3)
        out.bodies.append(read_body(reader, name, -1 if bone == _NONE else bone, origin))

    def add_joint() -> None:
        name, bodies = reader.field(20), reader.values("II")
        out.joints.append(read_joint(reader, name, (bodies[0], bodies[1])))

    _add_physics(reader, out, (83, 124), "I", (add_body, add_joint))
