"""The bytes of PMX 2.0, the models of MikuMikuDance: mesh, materials, bones with their dependencies, rigid bodies and
joints. Morphs are not written.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from bunraku.core.mmd_model import BODY_SHAPES, MMD_METRE, MmdBody, MmdBone, MmdJoint, mmd_angles
from bunraku.errors import FormatError
from bunraku.formats.mmd.build import MAX_BODIES, MAX_BONES, MAX_JOINTS, MmdFile, MmdMaterial

__all__ = ["pmx_bytes"]

_MIRROR = np.array([1.0, 1, -1])


class _Writer:
    """Bytes in the order of the file, with the sizes of indices that it needs."""

    def __init__(self, file: MmdFile):
        self.parts: list[bytes] = []
        self.bone, self.body = _signed(len(file.bones)), _signed(len(file.bodies))
        self.texture = _signed(len({material.texture for material in file.materials}))
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
        file: What it shall say; the pictures of its textures are files of their own.

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
    out.pack("9B", 8, 0, 0, out.vertex, out.texture, 1, out.bone, 1, out.body)
    for text in (file.name, file.english, "", ""):
        out.text(text)
    _vertices(out, file)
    out.pack("i", file.triangles.size)
    out.parts.append(np.asarray(file.triangles, {1: "u1", 2: "<u2", 4: "<i4"}[out.vertex]).tobytes())
    textures = list(dict.fromkeys(material.texture for material in file.materials if material.texture))
    out.pack("i", len(textures))
    for name in textures:
        out.text(name)
    out.pack("i", len(file.materials))
    for material in file.materials:
        _write_material(out, material, textures.index(material.texture) if material.texture else -1)
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


def _write_material(out: _Writer, material: MmdMaterial, texture: int) -> None:
    out.text(material.name)
    out.text("")
    out.floats([*material.diffuse, 0.1, 0.1, 0.1, 5.0, *material.ambient])  # with a faint specular
    out.pack("B", 0x1E | int(material.double_sided))  # shadows and an edge
    out.floats([0.1, 0.1, 0.15, 1, 0.6])
    out.index(texture, out.texture)
    out.index(-1, out.texture)
    out.pack("BBB", 0, 1, 0)  # no sphere map, the first shared toon
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
