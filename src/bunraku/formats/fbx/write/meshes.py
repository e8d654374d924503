"""The meshes of a character as it rests, in the world: what formats other than glTF write of its document."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.gltf.carry import MeshCarrier, carry_images, carry_tree
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.scene.mesh import MeshPart
from bunraku.formats.gltf.write import document_of
from bunraku.geometry.surface import vertex_normals

__all__ = ["Layer", "Mesh", "Shape", "meshes_of"]

MOST_UVS = 8


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape that a mesh can be blended to.

    Args:
        name: Its name.
        offsets: How far it takes each vertex [m], shape (V, 3).
        amount: How much of it shows where nothing moves, 0 to 1.
    """

    name: str
    offsets: np.ndarray
    amount: float = 0.0


@dataclass(frozen=True, eq=False)
class Layer:
    """Values of the corners of triangles.

    Args:
        values: Shape (U, C).
        corners: Row of each corner, shape (F, 3).
    """

    values: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh in the rest pose, in the world.

    Args:
        name: Its name.
        index: The character's vertex behind each of its own, shape (V,).
        faces: Triangles, shape (F, 3).
        materials: The material of each in the document, -1 for none, shape (F,).
        normals: Or None.
        uvs: Sets of texture coordinates, v downwards.
        colors: Linear colours and what of them is seen, (U, 4), or None.
        shapes: Those that the file has.
    """

    name: str
    index: np.ndarray
    faces: np.ndarray
    materials: np.ndarray
    normals: Layer | None
    uvs: list[Layer]
    colors: Layer | None
    shapes: list[Shape]


def meshes_of(character: Character) -> tuple[Document, list[Mesh]]:
    """The meshes of a character as it rests, and the document of their materials.

    Args:
        character: The character.
    """
    source = document_of(character)
    builder = GltfBuilder(carry_tree(source.document))
    carry_images(source.document, builder)
    carrier, start, carried = MeshCarrier(source, builder), 0, []
    for part in source.parts:
        index = source.index[start : start + sum(len(group.vertices) for group in part.groups)]
        start += len(index)
        if any(len(some) for group in part.groups for some in group.triangles):
            node = source.document.item("nodes", part.node)
            mesh = carrier.mesh(part, character.vertices[index], index)
            carried.append((str(node.get("name") or f"mesh_{part.mesh}"), part, index, mesh))
    document = builder.document(Path(character.name))
    return document, [_mesh(document, *one) for one in carried]


def _mesh(document: Document, name: str, part: MeshPart, index: np.ndarray, mesh: dict[str, Any]) -> Mesh:
    primitives: dict[int, dict[str, Any]] = {}
    own = iter(mesh["primitives"])
    for member in sorted(member for group in part.groups for member in group.primitives):
        primitives[member] = next(own)
    faces, materials, rows = [], [], []  # rows: the primitive's entry, its vertices, its triangles in them
    deltas: list[list[np.ndarray]] = []
    start = 0
    for group in part.groups:
        count = len(group.vertices)
        for member, triangles in zip(group.primitives, group.triangles, strict=True):
            faces.append(triangles.astype(np.int64) + start)
            material = primitives[member].get("material")
            materials.append(np.full(len(triangles), material if type(material) is int else -1))
            rows.append((primitives[member], count, triangles.astype(np.int64)))
        targets = document.objects(primitives[group.primitives[0]], "targets")
        deltas.append([_offsets(document, target, count) for target in targets])
        start += count
    names = _names(mesh, max(map(len, deltas), default=0))
    shapes = [
        Shape(label, np.concatenate([some[k] if k < len(some) else np.zeros((len(group.vertices), 3))
                                     for some, group in zip(deltas, part.groups, strict=True)]), amount)
        for k, (label, amount) in enumerate(names)
    ]  # fmt: skip
    sets = [
        number for number in range(MOST_UVS)
        if any(f"TEXCOORD_{number}" in entry["attributes"] for entry, _, _ in rows)
    ]  # fmt: skip
    uvs = [_layer(document, rows, f"TEXCOORD_{number}", 2, np.zeros(2)) for number in range(max(sets, default=-1) + 1)]
    colors = (
        _layer(document, rows, "COLOR_0", 4, np.ones(4))
        if any("COLOR_0" in entry["attributes"] for entry, _, _ in rows)
        else None
    )
    return Mesh(
        name, index, np.concatenate(faces), np.concatenate(materials), _normals(document, rows), uvs, colors, shapes
    )


def _offsets(document: Document, target: dict[str, Any], count: int) -> np.ndarray:
    if "POSITION" not in target or document.count(target["POSITION"]) != count:
        return np.zeros((count, 3))
    return document.accessor(target["POSITION"], ("VEC3",)).astype(np.float64)


def _names(mesh: dict[str, Any], count: int) -> list[tuple[str, float]]:
    """Name and amount of each shape of a mesh."""
    extras = mesh.get("extras")
    listed = extras.get("targetNames") if isinstance(extras, dict) else None
    names = [str(name) for name in listed] if isinstance(listed, list) and len(listed) == count else []
    weights = mesh.get("weights")
    amounts = weights if isinstance(weights, list) and len(weights) == count else [0.0] * count
    return [
        (names[k] if names else f"shape_{k}", float(amount) if isinstance(amount, int | float) else 0.0)
        for k, amount in enumerate(amounts)
    ]


_Rows = list[tuple[dict[str, Any], int, np.ndarray]]


def _layer(document: Document, rows: _Rows, name: str, width: int, default: np.ndarray) -> Layer:
    """An attribute of all primitives; those that share it share its values."""
    values: list[np.ndarray] = []
    corners, known, total = [], {}, 0
    for entry, count, triangles in rows:
        accessor = entry["attributes"].get(name)
        key = accessor if type(accessor) is int and document.count(accessor) == count else -1 - count
        if key not in known:
            known[key] = total
            if key >= 0:
                found = document.accessor(key, ("VEC2", "VEC3", "VEC4")).astype(np.float64)[:, :width]
                missing = np.tile(default[found.shape[1] :], (count, 1))
                values.append(np.nan_to_num(np.concatenate([found, missing], axis=1)))
            else:
                values.append(np.tile(default, (count, 1)))
            total += count
        corners.append(triangles + known[key])
    return Layer(np.concatenate(values), np.concatenate(corners))


def _normals(document: Document, rows: _Rows) -> Layer | None:
    """Normals, where any primitive has some; those of the surface for the others."""
    if not any("NORMAL" in entry["attributes"] for entry, _, _ in rows):
        return None
    layer = _layer(document, rows, "NORMAL", 3, np.zeros(3))
    start, values = 0, layer.values.copy()
    for entry, _, triangles in rows:
        stop = start + len(triangles)
        if "NORMAL" not in entry["attributes"] and len(triangles):
            corners = layer.corners[start:stop]
            first = int(corners.min() - triangles.min())
            positions = document.accessor(entry["attributes"]["POSITION"], ("VEC3",))
            values[first : first + len(positions)] = vertex_normals(positions, triangles)
        start = stop
    return Layer(values, layer.corners)
