"""A PMX or PMD model as a glTF document for writers and previews: mesh, materials, textures, the bones as a skin."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.avatars import MmdBone
from bunraku.core.files import path_inside
from bunraku.core.geometry.surface import unit_normals
from bunraku.files.gltf.colors import linear_from_srgb
from bunraku.files.gltf.document import (
    ARRAY_BUFFER,
    Document,
    GltfBuilder,
    matte_material,
    triangle_primitives,
    vertex_attributes,
)
from bunraku.files.meshes.obj import embeddable

LIGHT = 154 / 255
"""MMD's lamp: this share of the diffuse colour is seen, with the ambient colour added."""


@dataclass(frozen=True)
class MmdMaterial:
    """A material."""

    name: str
    diffuse: np.ndarray  # sRGB and opacity, from 0 to 1, shape (4,)
    ambient: np.ndarray  # sRGB, shape (3,)
    double_sided: bool  # whether triangles are seen from behind
    texture: str  # path of its texture as in the file, "" for none
    corners: int  # three times the number of its triangles


def model_document(
    path: Path,
    name: str,
    materials: Sequence[MmdMaterial],
    mesh: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    skin: tuple[np.ndarray, np.ndarray],
    bones: Sequence[MmdBone],
    note: Callable[[str, str], None],
) -> Document:
    """The document of a model whose textures are read from the folder of its file and below only. Materials are in the
    order of the triangles; the mesh is positions [m] (V, 3), normals (V, 3), UVs (V, 2) and triangles (F, 3), the skin
    bones (V, 4) and shares (V, 4) of each vertex. `note` is called with a problem and the name of its subject.
    """
    builder = GltfBuilder()
    positions, normals, uvs, triangles = mesh
    names = name or path.stem
    builder.tree["materials"] = _materials(path, materials, builder, note)
    attributes = vertex_attributes(builder, positions, unit_normals(normals), np.nan_to_num(uvs))
    if attributes and bones:
        attributes["JOINTS_0"] = builder.array(skin[0].astype("<u2"), ARRAY_BUFFER)
        attributes["WEIGHTS_0"] = builder.array(skin[1].astype(np.float32), ARRAY_BUFFER)
    ends = np.cumsum([max(material.corners, 0) // 3 for material in materials]).astype(int)
    parts = zip(np.split(triangles, ends), [*range(len(materials)), None], strict=True)
    primitives = [{"mode": 4, **each} for each in triangle_primitives(builder, attributes, len(positions), parts)]
    builder.tree["meshes"] = [{"name": names, "primitives": primitives}]
    node: dict[str, Any] = {"name": names, "mesh": 0}
    builder.add("nodes", node)
    if bones:
        node["skin"] = 0
        _add_skin(builder, bones)
        builder.tree["scenes"][0]["nodes"] = [0, 1]
    if not builder.tree["materials"]:
        del builder.tree["materials"]
    return builder.document(path)


def _add_skin(builder: GltfBuilder, bones: Sequence[MmdBone]) -> None:
    """Nodes of the bones under one for the skeleton, and the skin that binds the mesh to them."""
    parents, heads = [bone.parent for bone in bones], np.array([bone.position for bone in bones])
    offsets = heads - np.where(np.array(parents)[:, None] >= 0, heads[parents], 0)
    builder.add("nodes", {"name": "bones", "children": [2 + bone for bone, parent in enumerate(parents) if parent < 0]})
    joints = builder.bones([bone.name or f"bone_{index}" for index, bone in enumerate(bones)], parents, offsets)
    inverse = np.tile(np.eye(4), (len(bones), 1, 1))
    inverse[:, :3, 3] = -heads
    builder.add("skins", {"joints": joints, "skeleton": 1, "inverseBindMatrices": builder.matrices(inverse)})


def _materials(
    path: Path, materials: Sequence[MmdMaterial], builder: GltfBuilder, note: Callable[[str, str], None]
) -> list[dict[str, Any]]:
    images: dict[Path, tuple[int, bool] | None] = {}
    out = []
    for material in materials:
        colors = np.clip(np.nan_to_num([*material.diffuse[:3] * LIGHT + material.ambient, material.diffuse[3]]), 0, 1)
        found = _texture(path, material.texture, images, builder, note) if material.texture else None
        texture, clear = (None, False) if found is None else found
        entry = matte_material(material.name, [*linear_from_srgb(colors[:3]), colors[3]], texture)
        if clear:
            entry["alphaMode"] = "BLEND"
        if material.double_sided:
            entry["doubleSided"] = True
        out.append(entry)
    return out


def _texture(
    path: Path,
    name: str,
    images: dict[Path, tuple[int, bool] | None],
    builder: GltfBuilder,
    note: Callable[[str, str], None],
) -> tuple[int, bool] | None:
    """Number of a texture and whether it is transparent anywhere; None where none is inside the model's folder."""
    target = path_inside(path.parent, name)
    if target is None:
        note("textures are outside the model's folder and are left out", name)
        return None
    target = _whatever_case(path.parent, target)
    if target not in images:
        image = embeddable(target) if os.path.isfile(target) else None
        images[target] = None
        if image is not None:
            texture = builder.add("textures", {"source": builder.image(*image)})
            images[target] = texture, _transparent(image[0])
    if images[target] is None:
        note("textures are missing or cannot be read; their materials are plain", name)
    return images[target]


def _whatever_case(folder: Path, target: Path) -> Path:
    """The file of this path in a folder, with any capitals, as Windows allows."""
    root = folder.resolve()
    if os.path.isfile(target) or not target.is_relative_to(root):
        return target
    at = root
    for part in target.relative_to(root).parts:
        try:
            same = [entry for entry in os.listdir(at) if entry.lower() == part.lower()]
        except OSError:
            return target
        if not same:
            return target
        at = at / (part if part in same else same[0])
    return at if at.resolve().is_relative_to(root) else target


def _transparent(data: bytes) -> bool:
    import io

    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            return (
                "A" in image.getbands()
                and image.width * image.height < 70_000_000
                and bool(image.getchannel("A").getextrema()[0] < 250)  # type: ignore[operator, index]
            )
    except Exception:  # not a PNG, or one that will not open: seen as it is
        return False
