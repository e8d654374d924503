"""Write PMX 2.0, the models of MikuMikuDance: mesh, materials, bones with their dependencies, rigid bodies and joints.

`load_character` reads such a file back to the same character. What `MmdModel` does not keep is not written: the offsets
of morphs and the pictures of textures; materials have their colours.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import BODY_SHAPES, MMD_METRE, MmdBody, MmdBone, MmdJoint, mmd_angles, mmd_model
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write
from bunraku.formats.gltf.scene.colors import srgb_from_linear
from bunraku.formats.mmd.build import MAX_BODIES, MAX_BONES, MAX_JOINTS, MmdFile, MmdMaterial
from bunraku.formats.mmd.document import LIGHT

__all__ = ["pmx_bytes", "save_pmx", "write_pmx"]

_MIRROR = np.array([1.0, 1, -1])


def write_pmx(character: Character) -> bytes:
    """The PMX file of a character that is an MMD model: read from a PMX or PMD file, or of the wardrobe.

    Raises:
        FormatError: It is no MMD model, or its mesh is not the one that its model was read with.
    """
    return pmx_bytes(_file_of(character))


def save_pmx(character: Character, path: str | Path) -> Path:
    """Write `write_pmx` to a file; nothing half-written is left behind. Arguments and errors are those of
    `write_pmx`.
    """
    target = Path(path)
    data = write_pmx(character)
    with atomic_write(target) as stream:
        stream.write(data)
    return target


def _file_of(character: Character) -> MmdFile:
    """What the file of a character says, in MMD's frame and unit where `MmdFile` wants it."""
    name = Path(f"{character.name}.pmx")
    model = mmd_model(character)
    if model is None or character.rig is None:
        raise FormatError(
            name, "this character is no MMD model, so there is nothing to write as PMX; load one from a PMX or PMD file"
        )
    document = character.source.document
    primitives = document.tree["meshes"][0]["primitives"]
    attributes = primitives[0]["attributes"]
    positions = document.accessor(attributes["POSITION"], ("VEC3",)).astype(np.float64)
    if len(positions) != len(model.deforms):
        raise FormatError(name, "its mesh has other vertices than its model; load it again from its file")
    out = MmdFile("PMX 2.0", model.name, model.english)
    out.positions = _units(positions)
    out.normals = document.accessor(attributes["NORMAL"], ("VEC3",)).astype(np.float64) * _MIRROR
    out.uvs = document.accessor(attributes["TEXCOORD_0"], ("VEC2",)).astype(np.float64)
    out.deforms = model.deforms
    out.indices, out.weights = np.full((len(positions), 4), -1, np.int64), np.zeros((len(positions), 4))
    columns = min(4, character.rig.indices.shape[1])
    out.indices[:, :columns], out.weights[:, :columns] = (
        character.rig.indices[:, :columns],
        character.rig.weights[:, :columns],
    )
    out.sdef = np.zeros((len(positions), 3, 3))
    out.sdef[model.sdef.vertices] = (
        np.stack([model.sdef.center, model.sdef.r0, model.sdef.r1], axis=1) * _MIRROR / MMD_METRE
    )
    materials, triangles = document.tree.get("materials", []), []
    for primitive in primitives:
        if "indices" in primitive:
            corners = document.accessor(primitive["indices"], ("SCALAR",)).reshape(-1, 3)[:, ::-1].astype(np.int64)
            number = primitive.get("material")
            out.materials.append(_material(materials[number] if number is not None else {}, 3 * len(corners)))
            triangles.append(corners)
    out.triangles = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    out.bones, out.bodies, out.joints = list(model.bones), list(model.bodies), list(model.joints)
    return out


def _material(entry: dict, corners: int) -> MmdMaterial:
    """A material of MMD that is seen in the colour of one of glTF."""
    factor = np.array(entry.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1.0, 1, 1, 1]), float)
    seen = srgb_from_linear(factor[:3])
    diffuse = np.array([*seen, factor[3]], np.float32).astype(float)
    return MmdMaterial(
        str(entry.get("name", "material")),
        diffuse,
        seen - diffuse[:3] * LIGHT,
        bool(entry.get("doubleSided")),
        "",
        corners,
    )


def _units(positions: np.ndarray) -> np.ndarray:
    """Positions [m] as a file holds them, such that reading gives the same 32-bit numbers wherever there are such."""
    wanted = positions.astype(np.float32)
    best = (positions / MMD_METRE).astype(np.float32)
    for way in (-np.inf, np.inf):
        other = np.nextafter(best, np.float32(way))
        best = np.where((_read(best) != wanted) & (_read(other) == wanted), other, best)
    return best.astype(np.float64) * _MIRROR


def _read(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.astype(np.float64) * MMD_METRE, np.float32)


class _Writer:
    """Bytes in the order of the file, with the sizes of indices that it needs."""

    def __init__(self, file: MmdFile):
        self.parts: list[bytes] = []
        self.bone, self.body = _signed(len(file.bones)), _signed(len(file.bodies))
        self.vertex = 1 if len(file.positions) < 256 else 2 if len(file.positions) < 65536 else 4

    def pack(self, layout: str, *values: object) -> None:
        self.parts.append(struct.pack("<" + layout, *values))

    def floats(self, values: object) -> None:
        self.parts.append(np.asarray(values, "<f4").tobytes())

    def text(self, text: str) -> None:
        data = text.encode("utf-16-le", "replace")
        self.parts += [struct.pack("<i", len(data)), data]

    def index(self, value: int, size: int) -> None:
        self.parts.append(int(value).to_bytes(size, "little", signed=True))


def _signed(count: int) -> int:
    return 1 if count < 128 else 2 if count < 32768 else 4


def pmx_bytes(file: MmdFile) -> bytes:
    """The bytes of a PMX file; `read_pmx_file` reads them back.

    Args:
        file: What it shall say. Its textures are not written.

    Raises:
        FormatError: It has more bones, rigid bodies or joints than are read.
    """
    for what, count, most in (
        ("bones", len(file.bones), MAX_BONES),
        ("bodies", len(file.bodies), MAX_BODIES),
        ("joints", len(file.joints), MAX_JOINTS),
    ):
        if count > most:
            raise FormatError(
                Path(f"{file.name}.pmx"), f"it would have {count:,} {what}, and at most {most:,} are read; use fewer"
            )
    out = _Writer(file)
    out.parts.append(b"PMX ")
    out.pack("f", 2.1 if (file.deforms == 4).any() else 2.0)
    out.pack("9B", 8, 0, 0, out.vertex, 1, 1, out.bone, 1, out.body)
    for text in (file.name, file.english, "", ""):
        out.text(text)
    _vertices(out, file)
    out.pack("i", file.triangles.size)
    out.parts.append(np.asarray(file.triangles, {1: "u1", 2: "<u2", 4: "<i4"}[out.vertex]).tobytes())
    out.pack("i", 0)  # textures
    out.pack("i", len(file.materials))
    for material in file.materials:
        _write_material(out, material)
    out.pack("i", len(file.bones))
    for number, bone in enumerate(file.bones):
        _bone(out, bone, file.tails.get(number))
    out.pack("i", 0)  # morphs
    _frames(out, file)
    out.pack("i", len(file.bodies))
    for body in file.bodies:
        _body(out, body)
    out.pack("i", len(file.joints))
    for joint in file.joints:
        _joint(out, joint)
    return b"".join(out.parts)


def _vertices(out: _Writer, file: MmdFile) -> None:
    """Each vertex: position, normal and UV, then how it deforms, then its edge."""
    out.pack("i", len(file.positions))
    head = np.concatenate([file.positions, file.normals, file.uvs], axis=1).astype("<f4")
    bones = np.asarray(file.indices, {1: "i1", 2: "<i2", 4: "<i4"}[out.bone])
    weights, sdef = file.weights.astype("<f4"), file.sdef.reshape(len(file.positions), -1).astype("<f4")
    edge = struct.pack("<f", 1)
    for vertex, kind in enumerate(file.deforms.tolist()):
        out.parts += [head[vertex].tobytes(), bytes([kind])]
        if kind == 0:
            out.parts.append(bones[vertex, :1].tobytes())
        elif kind in (1, 3):
            out.parts += [bones[vertex, :2].tobytes(), weights[vertex, :1].tobytes()]
            if kind == 3:
                out.parts.append(sdef[vertex].tobytes())
        else:
            out.parts += [bones[vertex].tobytes(), weights[vertex].tobytes()]
        out.parts.append(edge)


def _write_material(out: _Writer, material: MmdMaterial) -> None:
    out.text(material.name)
    out.text("")
    out.floats([*material.diffuse, 0.1, 0.1, 0.1, 5.0, *material.ambient])  # with a faint specular
    out.pack("B", 0x1E | int(material.double_sided))  # shadows and an edge
    out.floats([0.1, 0.1, 0.15, 1, 0.6])
    out.pack("bbBBB", -1, -1, 0, 1, 0)  # no texture, no sphere map, the first shared toon
    out.text("")
    out.pack("i", material.corners)


def _bone(out: _Writer, bone: MmdBone, tail: int | None) -> None:
    out.text(bone.name)
    out.text(bone.english)
    out.floats(bone.position * _MIRROR / MMD_METRE)
    out.index(bone.parent, out.bone)
    append, ik = bone.append, bone.ik
    flags = (
        0x18
        | (tail is not None)
        | 0x2 * bone.rotates
        | 0x4 * bone.moves
        | 0x20 * (ik is not None)
        | 0x1000 * bone.after_physics
    )
    if append is not None:
        flags |= 0x80 * append.local | 0x100 * append.rotation | 0x200 * append.translation
    flags |= 0x400 * (bone.fixed_axis is not None) | 0x800 * (bone.local_axes is not None)
    out.pack("iH", bone.layer, flags)
    if tail is not None:
        out.index(tail, out.bone)
    else:
        out.floats((np.zeros(3) if bone.tail is None else bone.tail) * _MIRROR / MMD_METRE)
    if append is not None and flags & 0x300:
        out.index(append.bone, out.bone)
        out.pack("f", append.ratio)
    if bone.fixed_axis is not None:
        out.floats(bone.fixed_axis * _MIRROR)
    if bone.local_axes is not None:
        out.floats([bone.local_axes[0] * _MIRROR, -bone.local_axes[2] * _MIRROR])
    if ik is not None:
        out.index(ik.target, out.bone)
        out.pack("ifi", ik.loops, ik.limit, len(ik.links))
        for link in ik.links:
            out.index(link.bone, out.bone)
            limited = link.lower is not None and link.upper is not None
            out.pack("B", limited)
            if limited:
                out.floats(mmd_angles(link.lower, link.upper))


def _frames(out: _Writer, file: MmdFile) -> None:
    """The two display frames that editors expect, and one of all further bones."""
    out.pack("i", 3 if len(file.bones) > 1 else 2)
    for name, english, special, bones in (
        ("Root", "Root", 1, range(min(1, len(file.bones)))),
        ("表情", "Exp", 1, range(0)),
    ):
        _frame(out, name, english, special, bones)
    if len(file.bones) > 1:
        _frame(out, "ボーン", "Bones", 0, range(1, len(file.bones)))


def _frame(out: _Writer, name: str, english: str, special: int, bones: range) -> None:
    out.text(name)
    out.text(english)
    out.pack("Bi", special, len(bones))
    for bone in bones:
        out.pack("B", 0)
        out.index(bone, out.bone)


def _angles(turn: np.ndarray) -> np.ndarray:
    """MMD's angles about x, y, z [rad] of a rotation in our frame: the inverse of `mmd_turn`."""
    own = _MIRROR[:, None] * turn * _MIRROR
    x = np.arctan2(-own[1, 2], np.hypot(own[1, 0], own[1, 1]))
    if abs(own[1, 2]) > 1 - 1e-12:  # straight up or down: only the sum of the other two is known
        return np.array([x, np.arctan2(-own[2, 0], own[0, 0]), 0.0])
    return np.array([x, np.arctan2(own[0, 2], own[2, 2]), np.arctan2(own[1, 0], own[1, 1])])


def _body(out: _Writer, body: MmdBody) -> None:
    out.text(body.name)
    out.text("")
    out.index(body.bone, out.bone)
    out.pack("BHB", body.group, body.mask, BODY_SHAPES.index(body.shape))
    out.floats([body.size / MMD_METRE, body.position * _MIRROR / MMD_METRE, _angles(body.rotation)])
    out.floats([body.mass, body.linear_damping, body.angular_damping, body.restitution, body.friction])
    out.pack("B", body.mode)


def _joint(out: _Writer, joint: MmdJoint) -> None:
    out.text(joint.name)
    out.text("")
    out.pack("B", 0)  # a spring joint of six degrees of freedom, the only kind of PMX 2.0
    for body in joint.bodies:
        out.index(body, out.body)
    low, high = joint.lower * _MIRROR / MMD_METRE, joint.upper * _MIRROR / MMD_METRE
    low[2], high[2] = high[2], low[2]  # z is turned round
    out.floats([joint.position * _MIRROR / MMD_METRE, _angles(joint.rotation), low, high])
    out.floats([*mmd_angles(joint.angle_lower, joint.angle_upper), joint.spring, joint.angle_spring])
