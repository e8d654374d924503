"""Meshes as FBX: one geometry for each, its materials, its skin and its shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.fbx.write.bones import Bones
from bunraku.formats.fbx.write.encode import Element, element, prop, properties
from bunraku.formats.fbx.write.look import Look, uv_name
from bunraku.formats.fbx.write.meshes import Layer, Mesh, Shape
from bunraku.formats.fbx.write.objects import Objects
from bunraku.formats.frames import FileFrame
from bunraku.formats.gltf.scene.colors import srgb_from_linear

__all__ = ["add_mesh", "file_matrices"]

STILL = 1e-9  # m


def add_mesh(
    objects: Objects,
    mesh: Mesh,
    more: Sequence[Shape],
    character: Character,
    look: Look,
    bones: Bones | None,
    joints: Sequence[int],
) -> tuple[int, list[int]]:
    """Add a mesh, its materials, its skin and its shapes.

    Args:
        objects: The file.
        mesh: The mesh.
        more: Shapes beside its own.
        character: What it is of.
        look: Where its materials go.
        bones: What moves it, or None.
        joints: The numbers of these.

    Returns:
        The number of its model, and those of the channels of its shapes.
    """
    frame, name = objects.frame, objects.free_name(mesh.name, "nodes")
    points = frame.points(character.vertices[mesh.index].astype(np.float64))
    geometry = objects.add(
        "Geometry", name, "Mesh", properties(), element("GeometryVersion", 124),
        element("Vertices", points.reshape(-1)), element("PolygonVertexIndex", _polygons(mesh.faces)),
        *_layers(mesh, frame),
    )  # fmt: skip
    model = objects.add(
        "Model", name, "Mesh", element("Version", 232),
        properties(
            prop("InheritType", "enum", 1), prop("DefaultAttributeIndex", "int", 0),
            prop("Lcl Translation", "Lcl Translation", 0.0, 0.0, 0.0),
            prop("Lcl Rotation", "Lcl Rotation", 0.0, 0.0, 0.0), prop("Lcl Scaling", "Lcl Scaling", 1.0, 1.0, 1.0),
        ),
        element("Shading", True), element("Culling", "CullingOff"),
    )  # fmt: skip
    objects.link(model, 0)
    objects.link(geometry, model)
    for material in np.unique(mesh.materials).tolist():
        objects.link(look.material(material), model)
    if bones is not None:
        _add_skin(objects, geometry, name, mesh, bones, joints)
    return model, _add_shapes(objects, geometry, name, [*mesh.shapes, *more])


def _polygons(faces: np.ndarray) -> np.ndarray:
    """Corners one after another; the last of each is said as its complement."""
    out = faces.astype(np.int32)
    out[:, -1] = ~out[:, -1]
    return out.reshape(-1)


def _layers(mesh: Mesh, frame: FileFrame) -> list[Element]:
    out, listed = [], []

    def add(kind: str, number: int, name: str, *children: Element) -> None:
        out.append(element(kind, number, children=[element("Version", 101), element("Name", name), *children]))
        listed.append((kind, number))

    def mapped(layer: Layer, values: str, index: str) -> list[Element]:
        return [
            element("MappingInformationType", "ByPolygonVertex"), element("ReferenceInformationType", "IndexToDirect"),
            element(values, layer.values.reshape(-1)), element(index, layer.corners.astype(np.int32).reshape(-1)),
        ]  # fmt: skip

    if mesh.normals is not None:
        turned = Layer(mesh.normals.values @ frame.turn.T, mesh.normals.corners)
        add("LayerElementNormal", 0, "", *mapped(turned, "Normals", "NormalsIndex"))
    if mesh.colors is not None:
        shown = np.concatenate([srgb_from_linear(mesh.colors.values[:, :3]), mesh.colors.values[:, 3:]], axis=1)
        add("LayerElementColor", 0, "Col", *mapped(Layer(shown, mesh.colors.corners), "Colors", "ColorIndex"))
    for number, layer in enumerate(mesh.uvs):
        upwards = np.stack([layer.values[:, 0], 1 - layer.values[:, 1]], axis=1)
        add("LayerElementUV", number, uv_name(number), *mapped(Layer(upwards, layer.corners), "UV", "UVIndex"))
    slots = np.unique(mesh.materials, return_inverse=True)[1].astype(np.int32).reshape(-1)
    single = not slots.any()
    add(
        "LayerElementMaterial", 0, "",
        element("MappingInformationType", "AllSame" if single else "ByPolygon"),
        element("ReferenceInformationType", "IndexToDirect"), element("Materials", slots[:1] if single else slots),
    )  # fmt: skip
    for rank in range(max(len(mesh.uvs), 1)):
        members = [(kind, number) for kind, number in listed if number == rank]
        out.append(element("Layer", rank, children=[
            element("Version", 100),
            *(element("LayerElement", children=[element("Type", kind), element("TypedIndex", number)])
              for kind, number in members),
        ]))  # fmt: skip
    return out


def _add_skin(objects: Objects, geometry: int, name: str, mesh: Mesh, bones: Bones, joints: Sequence[int]) -> None:
    skin = objects.add(
        "Deformer", name, "Skin", element("Version", 101), element("Link_DeformAcuracy", 50.0),
        element("SkinningType", "Linear"),
    )  # fmt: skip
    objects.link(skin, geometry)
    indices, weights = bones.indices[mesh.index], bones.weights[mesh.index].astype(np.float64)
    rows, columns = np.nonzero(weights > 0)
    which, shares = indices[rows, columns], weights[rows, columns]
    order = np.lexsort((rows, which))
    rows, which, shares = rows[order], which[order], shares[order]
    binds = file_matrices(bones.bind, objects.frame)
    for bone in np.unique(which).tolist():
        first, last = np.searchsorted(which, [bone, bone + 1])
        own, column = np.unique(rows[first:last], return_inverse=True)  # a file may name a joint twice
        cluster = objects.add(
            "Deformer", bones.names[bone], "Cluster", element("Version", 100), element("UserData", "", ""),
            element("Indexes", own.astype(np.int32)),
            element("Weights", np.bincount(column, shares[first:last], len(own))),
            element("Transform", np.linalg.inv(binds[bone]).T.reshape(-1)),
            element("TransformLink", binds[bone].T.reshape(-1)), label="SubDeformer",
        )  # fmt: skip
        objects.link(cluster, skin)
        objects.link(joints[bone], cluster)


def file_matrices(matrices: np.ndarray, frame: FileFrame) -> np.ndarray:
    """World transforms [m] in the axes and the unit of the file, shape (J, 4, 4)."""
    out = matrices.copy()
    out[:, :3, :3] = frame.turn @ matrices[:, :3, :3]
    out[:, :3, 3] = frame.points(matrices[:, :3, 3])
    return out


def _add_shapes(objects: Objects, geometry: int, name: str, shapes: Sequence[Shape]) -> list[int]:
    if not shapes:
        return []
    deformer = objects.add("Deformer", name, "BlendShape", element("Version", 100))
    objects.link(deformer, geometry)
    channels = []
    for shape in shapes:
        moved = np.flatnonzero(np.abs(shape.offsets).max(axis=1) > STILL)
        moved = moved if len(moved) else np.zeros(1, np.int64)  # readers ask for one vertex at least
        offsets = objects.frame.points(shape.offsets[moved])
        channel = objects.add(
            "Deformer", shape.name, "BlendShapeChannel", element("Version", 100),
            properties(prop("DeformPercent", "number", 100 * shape.amount)),
            element("DeformPercent", 100 * shape.amount), element("FullWeights", np.array([100.0])),
            label="SubDeformer",
        )  # fmt: skip
        form = objects.add(
            "Geometry", shape.name, "Shape", element("Version", 100), element("Indexes", moved.astype(np.int32)),
            element("Vertices", offsets.reshape(-1)), element("Normals", np.zeros(3 * len(moved))),
        )  # fmt: skip
        objects.link(channel, deformer)
        objects.link(form, channel)
        channels.append(channel)
    return channels
