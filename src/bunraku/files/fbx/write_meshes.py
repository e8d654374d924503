"""Meshes, materials, textures, skins and shapes as FBX objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.core.geometry.axes import FileFrame
from bunraku.core.geometry.surface import vertex_normals
from bunraku.files.fbx.write_motion import Bones
from bunraku.files.fbx.write_objects import Element, Objects, element, prop, properties
from bunraku.files.gltf.carry import IMAGE_SUFFIXES, MeshCarrier, carry_images, carry_tree
from bunraku.files.gltf.colors import srgb_from_linear
from bunraku.files.gltf.document import Document, GltfBuilder
from bunraku.files.gltf.mesh import MeshPart
from bunraku.files.gltf.write import document_of
from bunraku.files.meshes.obj import embeddable

MOST_UVS = 8


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape that a mesh can be blended to."""

    name: str
    offsets: np.ndarray  # displacement of each vertex [m], shape (V, 3)
    amount: float = 0.0  # its amount where nothing moves, 0 to 1


@dataclass(frozen=True, eq=False)
class Layer:
    """Values of the corners of triangles: values (U, C), and the row of each corner (F, 3)."""

    values: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh in the rest pose, in the world."""

    name: str
    index: np.ndarray  # the character's vertex of each of its own, shape (V,)
    faces: np.ndarray  # triangles, shape (F, 3)
    materials: np.ndarray  # the material of each in the document, -1 for none, shape (F,)
    normals: Layer | None
    uvs: list[Layer]  # sets of texture coordinates, v downwards
    colors: Layer | None  # linear colours and opacity, (U, 4), or None
    shapes: list[Shape]  # those that the file has


def meshes_of(character: Character) -> tuple[Document, list[Mesh]]:
    """The meshes of a character as it rests, and the document of their materials."""
    source = document_of(character)
    builder = GltfBuilder(carry_tree(source.document))
    carry_images(source.document, builder)
    carrier, carried = MeshCarrier(source, builder), []
    for part, index in source.placed():
        if any(len(triangles) for group in part.groups for triangles in group.triangles):
            node = source.document.item("nodes", part.node)
            mesh = carrier.mesh(part, character.vertices[index], index)
            carried.append((str(node.get("name") or f"mesh_{part.mesh}"), part, index, mesh))
    document = builder.document(Path(character.name))
    return document, [_mesh(document, *entry) for entry in carried]


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
        Shape(label, np.concatenate([delta[k] if k < len(delta) else np.zeros((len(group.vertices), 3))
                                     for delta, group in zip(deltas, part.groups, strict=True)]), amount)
        for k, (label, amount) in enumerate(names)
    ]  # fmt: skip
    sets = [
        number for number in range(MOST_UVS)
        if any(f"TEXCOORD_{number}" in entry["attributes"] for entry, _, _ in rows)
    ]  # fmt: skip
    uvs = [_layer(document, rows, f"TEXCOORD_{number}", 2, np.zeros(2)) for number in range(max(sets, default=-1) + 1)]
    painted = any("COLOR_0" in entry["attributes"] for entry, _, _ in rows)
    colors, normals = _layer(document, rows, "COLOR_0", 4, np.ones(4)) if painted else None, _normals(document, rows)
    return Mesh(name, index, np.concatenate(faces), np.concatenate(materials), normals, uvs, colors, shapes)


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
    corners, numbers, total = [], {}, 0
    for entry, count, triangles in rows:
        accessor = entry["attributes"].get(name)
        key = accessor if type(accessor) is int and document.count(accessor) == count else -1 - count
        if key not in numbers:
            numbers[key] = total
            if key >= 0:
                found = document.accessor(key, ("VEC2", "VEC3", "VEC4")).astype(np.float64)[:, :width]
                missing = np.tile(default[found.shape[1] :], (count, 1))
                values.append(np.nan_to_num(np.concatenate([found, missing], axis=1)))
            else:
                values.append(np.tile(default, (count, 1)))
            total += count
        corners.append(triangles + numbers[key])
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


_CLAMP = 33071


def uv_name(number: int) -> str:
    """The name of a set of texture coordinates."""
    return "UVMap" if number == 0 else f"UVMap{number}"


@dataclass
class Look:
    """The materials of a document that are used, each once, with its textures inside the file."""

    objects: Objects  # where they go
    document: Document  # where they come from
    _materials: dict[int, int] = field(default_factory=dict)
    _textures: dict[tuple[int, int], int | None] = field(default_factory=dict)

    def material(self, index: int) -> int:
        """The number of a material; -1 stands for that of meshes without one."""
        if index not in self._materials:
            self._materials[index] = self._add(index)
        return self._materials[index]

    def _add(self, index: int) -> int:
        entry: dict[str, Any] = {"name": "default"} if index < 0 else self.document.item("materials", index)
        rough = entry.get("pbrMetallicRoughness")
        rough = rough if isinstance(rough, dict) else {}
        factor = np.clip(self.document.numbers(rough, "baseColorFactor", [1.0] * 4), 0, 1).tolist()
        glow = np.clip(self.document.numbers(entry, "emissiveFactor", [0.0] * 3), 0, 1).tolist()
        metallic, roughness = (
            float(np.clip(self.document.numbers({key: [rough.get(key, 1.0)]}, key, [1.0])[0], 0, 1))
            for key in ("metallicFactor", "roughnessFactor")
        )
        seen_through = entry.get("alphaMode") in ("MASK", "BLEND")
        clear = 1 - factor[3] if seen_through else 0.0
        name = self.objects.free_name(str(entry.get("name") or f"material_{index}"), "materials")
        number = self.objects.add(
            "Material", name, "", element("Version", 102), element("ShadingModel", "Phong"), element("MultiLayer", 0),
            properties(
                prop("ShadingModel", "string", "Phong"),
                prop("DiffuseColor", "color", *factor[:3]), prop("DiffuseFactor", "number", 1.0),
                prop("AmbientColor", "color", 0.0, 0.0, 0.0), prop("EmissiveColor", "color", *glow),
                prop("EmissiveFactor", "number", 1.0),
                prop("TransparentColor", "color", 1.0, 1.0, 1.0), prop("TransparencyFactor", "number", clear),
                prop("Opacity", "number", 1 - clear),
                prop("SpecularColor", "color", 0.2, 0.2, 0.2), prop("SpecularFactor", "number", 0.25),
                prop("ShininessExponent", "number", (10 * (1 - roughness)) ** 2),
                prop("Shininess", "number", (10 * (1 - roughness)) ** 2),
                prop("ReflectionColor", "color", 1.0, 1.0, 1.0), prop("ReflectionFactor", "number", metallic),
            ),
        )  # fmt: skip
        base = self._texture(rough.get("baseColorTexture"))
        self._bind(base, number, "DiffuseColor")
        if seen_through:
            self._bind(base, number, "TransparentColor")
        self._bind(self._texture(entry.get("normalTexture")), number, "NormalMap")
        if any(glow):
            self._bind(self._texture(entry.get("emissiveTexture")), number, "EmissiveColor")
        return number

    def _bind(self, texture: int | None, material: int, slot: str) -> None:
        if texture is not None:
            self.objects.link(texture, material, slot)

    def _texture(self, info: Any) -> int | None:
        """The number of a texture, None where there is none that can be written."""
        if not isinstance(info, dict) or type(info.get("index")) is not int:
            return None
        coordinates = info.get("texCoord", 0)
        key = info["index"], coordinates if type(coordinates) is int else 0
        if key not in self._textures:
            self._textures[key] = self._add_texture(*key)
        return self._textures[key]

    def _add_texture(self, index: int, coordinates: int) -> int | None:
        entry = self.document.item("textures", index)
        picture = _picture(self.document, entry)
        if picture is None:
            return None
        image, data, suffix = picture
        file = f"image_{image}{suffix}"
        sampler = self.document.item("samplers", entry["sampler"]) if "sampler" in entry else {}
        wrap = [1 if sampler.get(f"wrap{axis}") == _CLAMP else 0 for axis in "ST"]
        name = f"image_{image}"
        video = self.objects.add(
            "Video", name, "Clip", element("Type", "Clip"),
            properties(prop("Path", "url", file)), element("UseMipMap", 0),
            element("Filename", file), element("RelativeFilename", file), element("Content", data),
        )  # fmt: skip
        texture = self.objects.add(
            "Texture", name, "", element("Type", "TextureVideoClip"), element("Version", 202),
            element("TextureName", f"{name}\x00\x01Texture"), element("Media", f"{name}\x00\x01Video"),
            element("FileName", file), element("RelativeFilename", file),
            element("ModelUVTranslation", 0.0, 0.0), element("ModelUVScaling", 1.0, 1.0),
            element("Texture_Alpha_Source", "Alpha_Black" if suffix == ".png" else "None"),
            element("Cropping", 0, 0, 0, 0),
            properties(
                prop("UseMaterial", "bool", 1), prop("AlphaSource", "enum", 2),
                prop("UVSet", "string", uv_name(coordinates)),
                prop("WrapModeU", "enum", wrap[0]), prop("WrapModeV", "enum", wrap[1]),
            ),
        )  # fmt: skip
        self.objects.link(video, texture)
        return texture


def _picture(document: Document, texture: dict[str, Any]) -> tuple[int, bytes, str] | None:
    """The image of a texture: its index, its bytes as PNG or JPEG, and their suffix."""
    number = texture.get("source")
    webp = texture.get("extensions", {})
    if isinstance(webp, dict) and isinstance(webp.get("EXT_texture_webp"), dict):
        number = webp["EXT_texture_webp"].get("source", number)
    if type(number) is not int:
        return None
    stored = document.image(number)
    if not stored:
        return None
    image = embeddable(bytes(stored))
    return None if image is None else (number, image[0], IMAGE_SUFFIXES[image[1]])


STILL = 1e-9  # m; far below what float32 keeps of a position


def add_mesh(
    objects: Objects,
    mesh: Mesh,
    more: Sequence[Shape],
    character: Character,
    look: Look,
    bones: Bones | None,
    joints: Sequence[int],
) -> tuple[int, list[int]]:
    """Add a mesh, its materials, its skin by the numbers of the joints, and its shapes, `more` after its own; returns
    the number of its model, and those of the channels of its shapes.
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
    """Corners one after another; the last of each polygon is stored as its complement."""
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
        used, column = np.unique(rows[first:last], return_inverse=True)  # a file may name a joint twice
        cluster = objects.add(
            "Deformer", bones.names[bone], "Cluster", element("Version", 100), element("UserData", "", ""),
            element("Indexes", used.astype(np.int32)),
            element("Weights", np.bincount(column, shares[first:last], len(used))),
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
