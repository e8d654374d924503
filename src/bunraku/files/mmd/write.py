"""Write a character as PMX 2.0, with its own model or with one made of its rig."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import bone_order
from bunraku.core.avatars import BODY_SHAPES, MMD_METRE, MmdBody, MmdBone, MmdJoint, MmdModel, mmd_angles, mmd_model
from bunraku.core.character import Character, Handles, Rig, top_influences, written_rig
from bunraku.core.files import atomic_write
from bunraku.core.geometry.surface import vertex_normals
from bunraku.errors import CharacterError, FormatError
from bunraku.files.gltf.carry import IMAGE_SUFFIXES, free_name, image_type
from bunraku.files.gltf.colors import srgb_from_linear
from bunraku.files.gltf.document import Document
from bunraku.files.gltf.read import Source
from bunraku.files.gltf.write import document_of
from bunraku.files.mmd.document import LIGHT
from bunraku.files.mmd.model import MAX_BODIES, MAX_BONES, MAX_JOINTS, MmdFile, MmdMaterial

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
    """The bytes of a PMX file, which `read_pmx_file` reads back; the pictures of its textures are files of their own.
    FormatError if it has more bones, rigid bodies or joints than are read.
    """
    for kind, most in (("bones", MAX_BONES), ("bodies", MAX_BODIES), ("joints", MAX_JOINTS)):
        count = len(getattr(file, kind))
        if count > most:
            problem = f"it would have {count:,} {kind}, and at most {most:,} are read; use fewer"
            raise FormatError(Path(f"{file.name}.pmx"), problem)
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
    flags = 0x18 | (tail is not None) | 0x2 * bone.rotates | 0x4 * bone.moves | 0x1000 * bone.after_physics
    flags |= 0x20 * (ik is not None)
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
    count = len(file.bones)
    frames = [("Root", "Root", 1, range(min(1, count))), ("表情", "Exp", 1, range(0))]
    frames += [("ボーン", "Bones", 0, range(1, count))] if count > 1 else []
    out.pack("i", len(frames))
    for name, english, special, bones in frames:
        out.text(name)
        out.text(english)
        out.pack("Bi", special, len(bones))
        for bone in bones:
            out.pack("B", 0)
            out.index(bone, out.bone)


def _angles(turn: np.ndarray) -> np.ndarray:
    """MMD's angles about x, y, z [rad] of a rotation in our frame: the inverse of `mmd_rotation`."""
    mirrored = _MIRROR[:, None] * turn * _MIRROR
    x = np.arctan2(-mirrored[1, 2], np.hypot(mirrored[1, 0], mirrored[1, 1]))
    if abs(mirrored[1, 2]) > 1 - 1e-12:  # straight up or down: only the sum of the other two is known
        return np.array([x, np.arctan2(-mirrored[2, 0], mirrored[0, 0]), 0.0])
    return np.array([x, np.arctan2(mirrored[0, 2], mirrored[2, 2]), np.arctan2(mirrored[1, 0], mirrored[1, 1])])


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


def save_pmx(character: Character, path: str | Path, avatar: MmdModel | None = None) -> Path:
    """Write a character with a rig as PMX, and its pictures into a folder beside it, with the rigid bodies and joints
    of an avatar, by default those of its own model. CharacterError if it has no rig; FormatError if it has more bones
    than are read, or the file cannot be written.
    """
    target = Path(path)
    file = pmx_file(character)
    if avatar is not None:
        file.bodies, file.joints = list(avatar.bodies), list(avatar.joints)
    pictures = _pictures(document_of(character).document, f"{target.stem}-textures")
    file.materials = [
        replace(material, texture=pictures[material.texture][0] if material.texture in pictures else "")
        for material in file.materials
    ]
    data = pmx_bytes(file)
    for name, picture in pictures.values():
        with atomic_write(target.parent / name) as stream:
            stream.write(picture)
    with atomic_write(target) as stream:
        stream.write(data)
    return target


def write_character(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, avatar: MmdModel | None = None
) -> Path:
    """`save_pmx` in the form that the registry calls. CharacterError if there is no rig to write; FormatError if the
    file cannot be written.
    """
    if not rig and handles is not None:
        raise CharacterError(
            f"{character.name}: a PMX has a tree of bones, which handles are not; name a skeleton (--skeleton vrm)"
        )
    return save_pmx(character, path, avatar)


def pmx_file(character: Character) -> MmdFile:
    """The PMX of a character, in MMD's frame and unit where `MmdFile` wants it. The texture of a material is the number
    of its image, as text. CharacterError if it has no rig; FormatError if its mesh is not the one that its model was
    read with.
    """
    rig, model = written_rig(character), mmd_model(character)
    same = model is not None and len(model.bones) == len(rig.names)
    out = MmdFile("PMX 2.0", model.name if model and same else character.name, model.english if model and same else "")
    source = document_of(character)
    index = _mesh(out, character, source)
    if rig.indices.shape[1] > 4:
        order, kept = top_influences(rig.weights, 4)
        bones, shares = np.take_along_axis(rig.indices, order, axis=1).astype(np.int64), kept.astype(float)
    else:
        more = (0, 0), (0, 4 - rig.indices.shape[1])
        bones = np.pad(rig.indices.astype(np.int64), more, constant_values=-1)
        shares = np.pad(rig.weights.astype(float), more)
    out.sdef = np.zeros((len(index), 3, 3))
    if model is not None and same and len(model.deforms) == len(index):
        out.deforms = model.deforms
        constants = np.stack([model.sdef.center, model.sdef.r0, model.sdef.r1], axis=1)
        out.sdef[model.sdef.vertices] = constants * _MIRROR / MMD_METRE
        out.bones = list(model.bones)
    else:
        order = np.argsort(-shares, axis=1, kind="stable")
        bones, shares = np.take_along_axis(bones, order, axis=1), np.take_along_axis(shares, order, axis=1)
        count = (shares > 0).sum(axis=1)
        out.deforms = np.select([count[index] <= 1, count[index] == 2], [0, 1], 2).astype(np.uint8)
        bones = np.where(shares > 0, bones, np.where(np.arange(4) == 0, np.maximum(bones, 0), -1))
        out.bones = _bones(rig)
        out.tails = _tails(rig.parents)
    out.indices, out.weights = bones[index], shares[index]
    if model is not None:
        out.bodies, out.joints = list(model.bodies), list(model.joints)
    return out


def _mesh(out: MmdFile, character: Character, source: Source) -> np.ndarray:
    """Put the document's vertices and triangles into a file; returns the character's vertex of each."""
    document, base = source.document, 0
    smooth = vertex_normals(character.vertices.astype(np.float64), character.faces)
    chosen, uvs, normals, triangles = [], [], [], []
    materials = document.items("materials")
    for part, rows in source.placed():
        primitives = document.objects(document.item("meshes", part.mesh), "primitives")
        for group, ids in part.split(rows):
            attributes = primitives[group.primitives[0]].get("attributes", {})
            texture, uv = attributes.get("TEXCOORD_0"), np.zeros((len(ids), 2))
            if texture is not None:
                uv = document.accessor(texture, ("VEC2",)).astype(np.float64)
            for number, corners in zip(group.primitives, group.triangles, strict=True):
                if len(corners):
                    material = primitives[number].get("material")
                    entry = materials[material] if type(material) is int and material < len(materials) else {}
                    out.materials.append(_material(document, entry, 3 * len(corners)))
                    triangles.append(base + np.asarray(corners, np.int64)[:, ::-1])
            normal = smooth[ids]
            kept = source.moved is None and part.transform is not None and np.array_equal(part.transform, np.eye(4))
            if kept and "NORMAL" in attributes:
                normal = document.accessor(attributes["NORMAL"], ("VEC3",)).astype(np.float64)
            normals.append(normal)
            chosen.append(ids)
            uvs.append(uv)
            base += len(ids)
    index = np.concatenate(chosen)
    out.positions = _units(character.vertices[index].astype(np.float64))
    out.normals, out.uvs = np.concatenate(normals) * _MIRROR, np.concatenate(uvs)
    out.triangles = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    return index


def _material(document: Document, entry: dict[str, Any], corners: int) -> MmdMaterial:
    """A material of MMD that shows the colour of one of glTF."""
    shader = entry.get("pbrMetallicRoughness", {})
    factor = np.array(shader.get("baseColorFactor", [1.0, 1, 1, 1]), float)
    seen = srgb_from_linear(factor[:3])
    diffuse = np.array([*seen, factor[3]], np.float32).astype(float)
    texture = shader.get("baseColorTexture", {}).get("index")
    textures = document.items("textures")
    image = textures[texture].get("source") if type(texture) is int and 0 <= texture < len(textures) else None
    return MmdMaterial(
        str(entry.get("name", "material")), diffuse, seen - diffuse[:3] * LIGHT, bool(entry.get("doubleSided")),
        "" if type(image) is not int else str(image), corners,
    )  # fmt: skip


def _pictures(document: Document, folder: str) -> dict[str, tuple[str, bytes]]:
    """Path and bytes of each picture that MMD can show, by the number of its image."""
    out = {}
    for number, image in enumerate(document.items("images")):
        data: bytes | memoryview | None = document.images.get(number)
        if data is None and "bufferView" in image:
            data = document.view(image["bufferView"])
        if data is not None:
            kind = IMAGE_SUFFIXES.get(image_type(bytes(data[:16])) or "")
            if kind:
                out[str(number)] = (f"{folder}/{number}{kind}", bytes(data))
    return out


def _bones(rig: Rig) -> list[MmdBone]:
    names: dict[str, int] = {}
    for bone, name in enumerate(rig.names):  # MMD knows bones by their names
        names[free_name(name, names, " ")] = bone
    layers = _layers(rig.parents)
    return [
        MmdBone(name, name, rig.positions[bone], int(rig.parents[bone]), layers[bone],
                moves=rig.parents[bone] < 0, tail=np.array([0.0, 0.05, 0]))
        for name, bone in names.items()
    ]  # fmt: skip


def _layers(parents: np.ndarray) -> list[int]:
    """The layer of each bone: MMD moves bones in the file's order, so a child before its parent needs a higher one."""
    out = [0] * len(parents)
    for bone in bone_order(parents):
        parent = int(parents[bone])
        if parent >= 0:
            out[bone] = out[parent] + (parent > bone)
    return out


def _tails(parents: np.ndarray) -> dict[int, int]:
    """The bone that each points at: its only child."""
    below = {bone: np.flatnonzero(parents == bone) for bone in range(len(parents))}
    return {bone: int(children[0]) for bone, children in below.items() if len(children) == 1}


def _units(positions: np.ndarray) -> np.ndarray:
    """Positions [m] in MMD's unit, such that reading gives the same 32-bit numbers wherever possible."""
    wanted = positions.astype(np.float32)
    best = (positions / MMD_METRE).astype(np.float32)
    for way in (-np.inf, np.inf):
        other = np.nextafter(best, np.float32(way))
        best = np.where((_read(best) != wanted) & (_read(other) == wanted), other, best)
    return best.astype(np.float64) * _MIRROR


def _read(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.astype(np.float64) * MMD_METRE, np.float32)
