"""Write a character as PMX: one that was read from an MMD file as its model says, any other with its rig, and with the
rigid bodies and joints that its avatar holds.

`load_character` reads such a file back to the same character. Offsets of morphs, which `MmdModel` does not keep, are
not written. Pictures go into a folder beside the file.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character, Handles, top_influences
from bunraku.core.mmd_model import MMD_METRE, MmdBone, MmdModel, mmd_model
from bunraku.core.rig_animation import bone_order
from bunraku.errors import CharacterError, FormatError
from bunraku.formats.files import atomic_write
from bunraku.formats.gltf.carry import image_type
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.read import Source
from bunraku.formats.gltf.scene.colors import srgb_from_linear
from bunraku.formats.gltf.write import document_of
from bunraku.formats.mmd.build import MmdFile, MmdMaterial
from bunraku.formats.mmd.document import LIGHT
from bunraku.formats.mmd.pmx_write import pmx_bytes
from bunraku.geometry.surface import vertex_normals

__all__ = ["pmx_file", "save_pmx", "write_character", "write_pmx"]

_MIRROR = np.array([1.0, 1, -1])
_ENDINGS = {"image/png": ".png", "image/jpeg": ".jpg"}


def write_pmx(character: Character) -> bytes:
    """The PMX file of a character with a rig, without the pictures of its textures.

    Raises:
        CharacterError: It has no rig.
        FormatError: It has more bones than are read, or its mesh is not the one that its model was read with.
    """
    return pmx_bytes(pmx_file(character))


def save_pmx(character: Character, path: str | Path, avatar: MmdModel | None = None) -> Path:
    """Write a character as PMX, and its pictures into a folder beside it; nothing half-written is left behind.

    Args:
        character: With a rig.
        path: The file.
        avatar: Rigid bodies and joints of its bones; those of its model by default.

    Raises:
        CharacterError: It has no rig.
        FormatError: It has more bones than are read, or the file cannot be written.
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
    try:
        for name, picture in pictures.values():
            place = target.parent / name
            place.parent.mkdir(exist_ok=True)
            with atomic_write(place) as stream:
                stream.write(picture)
    except OSError as error:
        raise FormatError(target, f"its pictures cannot be written ({error.strerror}); name another folder") from None
    with atomic_write(target) as stream:
        stream.write(data)
    return target


def write_character(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, avatar: MmdModel | None = None
) -> Path:
    """Write a character to PMX with its rig, and with the rigid bodies and joints of an avatar by its bones.

    Raises:
        CharacterError: There is no rig to write.
        FormatError: The file cannot be written.
    """
    if not rig and handles is not None:
        raise CharacterError(
            f"{character.name}: a PMX has a tree of bones, and handles are none; name a skeleton (--skeleton vrm)"
        )
    return save_pmx(character, path, avatar)


def pmx_file(character: Character) -> MmdFile:
    """What a PMX of a character says, in MMD's frame and unit where `MmdFile` wants it. The texture of a material is
    the number of its image, in words.

    Raises:
        CharacterError: It has no rig.
        FormatError: Its mesh is not the one that its model was read with.
    """
    rig, model = character.rig, mmd_model(character)
    if rig is None:
        raise CharacterError(f"{character.name}: there is no rig to write; make one with `bunraku.with_skeleton`")
    own = model is not None and len(model.bones) == len(rig.names)
    out = MmdFile("PMX 2.0", model.name if model and own else character.name, model.english if model and own else "")
    source = document_of(character)
    index = _mesh(out, character, source)
    width = min(4, rig.indices.shape[1])
    shares = np.zeros((len(character.vertices), 4))
    bones = np.full((len(character.vertices), 4), -1, np.int64)
    if rig.indices.shape[1] > 4:
        order, kept = top_influences(rig.weights, 4)
        bones[:], shares[:] = np.take_along_axis(rig.indices, order, axis=1), kept
    else:
        bones[:, :width], shares[:, :width] = rig.indices[:, :width], rig.weights[:, :width]
    out.sdef = np.zeros((len(index), 3, 3))
    if model is not None and own and len(model.deforms) == len(index):
        out.deforms = model.deforms
        out.sdef[model.sdef.vertices] = (
            np.stack([model.sdef.center, model.sdef.r0, model.sdef.r1], axis=1) * _MIRROR / MMD_METRE
        )
        out.bones = list(model.bones)
    else:
        order = np.argsort(-shares, axis=1, kind="stable")
        bones, shares = np.take_along_axis(bones, order, axis=1), np.take_along_axis(shares, order, axis=1)
        count = (shares > 0).sum(axis=1)
        out.deforms = np.select([count[index] <= 1, count[index] == 2], [0, 1], 2).astype(np.uint8)
        bones = np.where(shares > 0, bones, np.where(np.arange(4) == 0, np.maximum(bones, 0), -1))
        out.bones = _bones(character)
        out.tails = _tails(rig.parents)
    out.indices, out.weights = bones[index], shares[index]
    if model is not None:
        out.bodies, out.joints = list(model.bodies), list(model.joints)
    return out


def _mesh(out: MmdFile, character: Character, source: Source) -> np.ndarray:
    """Put the document's vertices and triangles into a file; gives the character's vertex of each."""
    document, start, base = source.document, 0, 0
    smooth = vertex_normals(character.vertices.astype(np.float64), character.faces)
    chosen, uvs, normals, triangles = [], [], [], []
    materials = document.items("materials")
    for part in source.parts:
        primitives = document.objects(document.item("meshes", part.mesh), "primitives")
        for group in part.groups:
            own = source.index[start : start + len(group.vertices)]
            start += len(own)
            attributes = primitives[group.primitives[0]].get("attributes", {})
            known = attributes.get("TEXCOORD_0")
            uv = np.zeros((len(own), 2)) if known is None else document.accessor(known, ("VEC2",)).astype(np.float64)
            for number, corners in zip(group.primitives, group.triangles, strict=True):
                if len(corners):
                    material = primitives[number].get("material")
                    entry = materials[material] if type(material) is int and material < len(materials) else {}
                    out.materials.append(_material(document, entry, 3 * len(corners)))
                    triangles.append(base + np.asarray(corners, np.int64)[:, ::-1])
            kept = source.moved is None and part.transform is not None and np.array_equal(part.transform, np.eye(4))
            normals.append(
                document.accessor(attributes["NORMAL"], ("VEC3",)).astype(np.float64)
                if kept and "NORMAL" in attributes
                else smooth[own]
            )
            chosen.append(own)
            uvs.append(uv)
            base += len(own)
    index = np.concatenate(chosen)
    out.positions = _units(character.vertices[index].astype(np.float64))
    out.normals, out.uvs = np.concatenate(normals) * _MIRROR, np.concatenate(uvs)
    out.triangles = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    return index


def _material(document: Document, entry: dict[str, Any], corners: int) -> MmdMaterial:
    """A material of MMD that is seen in the colour of one of glTF."""
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
            kind = _ENDINGS.get(image_type(bytes(data[:16])) or "")
            if kind:
                out[str(number)] = (f"{folder}/{number}{kind}", bytes(data))
    return out


def _bones(character: Character) -> list[MmdBone]:
    rig = character.rig
    assert rig is not None
    names, seen = [], set()
    for name in rig.names:  # MMD knows bones by their names
        label, number = name, 2
        while label in seen:
            label, number = f"{name} {number}", number + 1
        seen.add(label)
        names.append(label)
    layers = _layers(rig.parents)
    return [
        MmdBone(name, name, rig.positions[bone], int(rig.parents[bone]), layers[bone],
                moves=rig.parents[bone] < 0, tail=np.array([0.0, 0.05, 0]))
        for bone, name in enumerate(names)
    ]  # fmt: skip


def _layers(parents: np.ndarray) -> list[int]:
    """The layer of each bone: MMD moves bones in the order of the file, so one whose parent comes later is in a higher
    layer than that.
    """
    out = [0] * len(parents)
    for bone in bone_order(parents):
        parent = int(parents[bone])
        if parent >= 0:
            out[bone] = out[parent] + (parent > bone)
    return out


def _tails(parents: np.ndarray) -> dict[int, int]:
    """The bone that each points at: its only child."""
    return {
        bone: int(np.flatnonzero(parents == bone)[0])
        for bone in range(len(parents))
        if np.count_nonzero(parents == bone) == 1
    }


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
