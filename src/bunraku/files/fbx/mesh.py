"""Meshes of an FBX file with their materials, skin weights, and joints as they stood when bound."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.geometry.surface import unit_normals
from bunraku.files.fbx.nodes import BROKEN, FbxNode
from bunraku.files.fbx.scene import FbxObject, FbxScene
from bunraku.files.gltf.document import matte_material
from bunraku.files.gltf.mesh import strongest
from bunraku.files.meshes.obj import beside, embeddable, fans, split_corners

INFLUENCES = 8
"""Most joints that are kept for a vertex."""


@dataclass(frozen=True, eq=False)
class FbxMesh:
    """A mesh with one UV, normal and colour a vertex: a control point whose corners differ occurs several times."""

    points: np.ndarray  # control points in the mesh's own frame and unit, shape (P, 3)
    index: np.ndarray  # control point of each vertex, the control points themselves first, shape (U,)
    triangles: np.ndarray  # vertices of each triangle, shape (F, 3)
    materials: np.ndarray  # material slot of each triangle, shape (F,)
    uvs: np.ndarray | None  # with v upwards, shape (U, 2)
    normals: np.ndarray | None  # shape (U, 3)
    colors: np.ndarray | None  # sRGB from 0 to 1, shape (U, 3)


@dataclass(frozen=True, eq=False)
class Cluster:
    """What one joint moves of a mesh."""

    joint: FbxObject
    transform: np.ndarray  # from the mesh's frame to the joint's in the bind pose, shape (4, 4)
    bind: np.ndarray  # the joint's world transform in the bind pose, shape (4, 4)
    thing: FbxObject  # the object that holds the weights


@dataclass(frozen=True, eq=False)
class FbxSkin:
    """What moves the control points of a mesh."""

    clusters: list[Cluster]  # one for each joint
    indices: np.ndarray  # clusters that move each control point, shape (P, M)
    weights: np.ndarray  # their shares; all zero for a control point that no cluster moves, shape (P, M)


def read_mesh(scene: FbxScene, geometry: FbxObject) -> FbxMesh:
    """The mesh of a Geometry object. FormatError if a polygon uses a control point that does not exist, or the arrays
    do not fit together.
    """
    fail = scene.tree.fail
    numbers, stored = geometry.node.array("Vertices").astype(float), geometry.node.array("PolygonVertexIndex")
    if len(numbers) % 3 or stored.dtype.kind not in "if" or (stored.dtype.kind == "f" and len(stored)):
        fail(f"the mesh '{geometry.name}' has arrays that do not fit together; {BROKEN}")
    points, stored = numbers.reshape(-1, 3), stored.astype(np.int64)
    last = stored < 0  # the last corner of a polygon is stored as its complement
    corners = np.where(last, ~stored, stored)
    if len(corners) and (int(corners.max()) >= len(points) or not last[-1]):
        worst = int(corners.max())
        fail(f"a face of '{geometry.name}' never ends or uses vertex {worst} but there are {len(points)}; {BROKEN}")
    ends = np.flatnonzero(last)
    sizes = np.diff(ends, prepend=-1)
    polygon = np.repeat(np.arange(len(sizes)), sizes)

    uvs = _layer(geometry.node, "LayerElementUV", "UV", "UVIndex", 2, corners, polygon)
    normals = _layer(geometry.node, "LayerElementNormal", "Normals", "NormalsIndex", 3, corners, polygon)
    colors = _layer(geometry.node, "LayerElementColor", "Colors", "ColorIndex", 4, corners, polygon)
    normals = None if normals is None else unit_normals(normals)
    columns = [corners, _labels(uvs, 1e6), _labels(normals, 1e3), _labels(colors, 255)]
    chosen, of_corner = _unique_rows([column for column in columns if column is not None])
    slots, index, corner_of = split_corners(corners[chosen][:, None], len(points))
    triangles, materials = fans(slots[of_corner], sizes, _materials(geometry.node, len(sizes)))

    def spread(values: np.ndarray | None, default: Sequence[float]) -> np.ndarray | None:
        if values is None:
            return None
        out = np.tile(np.array(default, float), (len(index), 1))
        out[corner_of >= 0] = values[chosen[corner_of[corner_of >= 0]], : len(default)]
        return out

    return FbxMesh(
        points, index, triangles, materials, spread(uvs, (0, 0)), spread(normals, (0, 1, 0)), spread(colors, (1, 1, 1))
    )


def _layer(
    node: FbxNode, name: str, values_name: str, index_name: str, width: int, corners: np.ndarray, polygon: np.ndarray
) -> np.ndarray | None:
    """Values of the first layer of a kind for each corner, shape (corners, width); None where none can be used."""
    layer = node.child(name)
    if layer is None:
        return None
    values = layer.array(values_name).astype(float)
    values = np.nan_to_num(values[: len(values) // width * width].reshape(-1, width), posinf=0, neginf=0)
    rows = _rows_of(layer.text("MappingInformationType"), corners, polygon)
    if rows is None:
        return None
    if layer.text("ReferenceInformationType") != "Direct":
        index = layer.array(index_name).astype(np.int64)
        if len(index):
            if rows.max(initial=0) >= len(index):
                return None
            rows = index[rows]
    if not len(values) or rows.min(initial=0) < 0 or rows.max(initial=0) >= len(values):
        return None
    return values[rows]


def _rows_of(mapping: str, corners: np.ndarray, polygon: np.ndarray) -> np.ndarray | None:
    kinds = {
        "ByPolygonVertex": np.arange(len(corners)),
        "ByVertice": corners,
        "ByVertex": corners,
        "ByPolygon": polygon,
        "AllSame": polygon * 0,
    }
    return kinds.get(mapping)


def _materials(node: FbxNode, polygons: int) -> np.ndarray:
    layer = node.child("LayerElementMaterial")
    slots = layer.array("Materials").astype(np.int64) if layer is not None else np.zeros(0, np.int64)
    if layer is not None and layer.text("MappingInformationType") == "ByPolygon" and len(slots) >= polygons:
        return slots[:polygons]
    return np.full(polygons, slots[0] if len(slots) else 0)


def _labels(values: np.ndarray | None, scale: float) -> np.ndarray | None:
    """Numbers that are equal where rows are, up to rounding."""
    if values is None:
        return None
    rounded = np.round(np.clip(values, -1e9, 1e9) * scale).astype(np.int64)
    return _unique_rows(list(rounded.T))[1]


def _unique_rows(columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Different rows of columns of integers: the first index of each, and the number of each row among them."""
    label = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        code = np.unique(column, return_inverse=True)[1]
        label = np.unique(label * (int(code.max(initial=0)) + 1) + code, return_inverse=True)[1]
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(first)  # in the order of the file, so that the first corner of a vertex keeps its place
    index = np.empty_like(order)
    index[order] = np.arange(len(order))
    return first[order], index[label]


def read_clusters(scene: FbxScene, geometry: FbxObject) -> list[Cluster]:
    """The clusters of a mesh that name a joint and its bind pose."""
    out = []
    for skin in scene.below(geometry, "Deformer", "Skin"):
        for thing in scene.below(skin, "Deformer", "Cluster"):
            joint = next((model for model in scene.below(thing, "Model") if model.id in scene.indices), None)
            transform, bind = (_matrix(thing.node.array(name)) for name in ("Transform", "TransformLink"))
            if joint is not None and transform is not None and bind is not None:
                out.append(Cluster(joint, transform, bind, thing))
    return out


def read_skin(scene: FbxScene, geometry: FbxObject, points: int) -> FbxSkin | None:
    """The clusters of a mesh of some control points as one skin, None where it has none that can be used. FormatError
    if a cluster moves a control point that does not exist.
    """
    clusters = read_clusters(scene, geometry)
    if not clusters:
        return None
    which, who, shares = [], [], []
    for number, cluster in enumerate(clusters):
        node = cluster.thing.node
        index, weight = node.array("Indexes").astype(np.int64), node.array("Weights").astype(float)
        if len(index) != len(weight) or index.min(initial=0) < 0 or index.max(initial=0) >= points:
            worst = int(index.max(initial=0))
            scene.tree.fail(f"the skin of '{geometry.name}' moves vertex {worst} but there are {points}; {BROKEN}")
        which.append(index)
        who.append(np.full(len(index), number))
        shares.append(np.where(np.isfinite(weight) & (weight > 0), weight, 0))
    return FbxSkin(
        clusters, *strongest(np.concatenate(which), np.concatenate(who), np.concatenate(shares), points, INFLUENCES)
    )


def _matrix(numbers: np.ndarray) -> np.ndarray | None:
    """A matrix that the file stores column by column, None if there is none or it is flat."""
    if len(numbers) != 16 or not np.isfinite(numbers).all():
        return None
    out = numbers.astype(float).reshape(4, 4).T
    out[3] = 0, 0, 0, 1
    return out if abs(np.linalg.det(out[:3, :3])) > 1e-30 else None


BONES = ("LimbNode", "Limb", "Root")
"""Kinds of model that are joints."""


def bind_matrices(scene: FbxScene, world: np.ndarray, clusters: list[Cluster]) -> dict[int, np.ndarray]:
    """World transforms of all joints in the bind pose, in the file's frame and unit. Clusters state those of the joints
    that they move; the others are where the default pose, shape (M, 4, 4), has them relative to a joint that is known.
    """
    binds: dict[int, np.ndarray] = {}
    for cluster in clusters:
        binds.setdefault(scene.indices[cluster.joint.id], cluster.bind)
    bones = [index for index, model in enumerate(scene.models) if model.subtype in BONES]
    if not binds:
        return {index: world[index] for index in bones}
    for index in reversed(bones):  # up the tree first, so that roots that move nothing stand where their children say
        parent = int(scene.parents[index])
        if index in binds and parent >= 0 and parent not in binds and scene.models[parent].subtype in BONES:
            binds[parent] = binds[index] @ inverses(world[index][None])[0] @ world[parent]
    for index in bones:
        parent = int(scene.parents[index])
        if index not in binds:
            binds[index] = world[index]
            if parent in binds:
                binds[index] = binds[parent] @ inverses(world[parent][None])[0] @ world[index]
    return dict(sorted(binds.items()))


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses, or for flat matrices pseudo-inverses, shape (N, 4, 4)."""
    flat = np.abs(np.linalg.det(matrices[:, :3, :3])) < 1e-30
    return np.linalg.pinv(matrices) if flat.any() else np.linalg.inv(matrices)


MAX_IMAGES = 256
_BASE_COLORS = ("DiffuseColor", "Diffuse", "Maya|baseColor", "3dsMax|Parameters|base_color_map")


class Materials:
    """The materials that the meshes of a file use, each once.

    A texture is taken from the file itself, from its folder, or from the `.fbm` or `textures` folder beside it; one
    that lies elsewhere or cannot be read leaves its material without it, since the mesh is still good.
    """

    def __init__(self, scene: FbxScene):
        self.scene = scene
        self.materials: list[dict[str, Any]] = []
        self.images: list[tuple[bytes, str]] = []
        self._numbers: dict[int, int] = {}
        self._textures: dict[tuple[int, str], int | None] = {}

    def number(self, material: FbxObject) -> int:
        """Index of a material, added where it is new."""
        if material.id not in self._numbers:
            self._numbers[material.id] = len(self.materials)
            self.materials.append(self._build(material))
        return self._numbers[material.id]

    def _build(self, thing: FbxObject) -> dict[str, Any]:
        color = np.clip(thing.numbers("DiffuseColor", tuple(thing.numbers("Diffuse", (0.8, 0.8, 0.8)))), 0, 1)
        color = color * np.clip(thing.number("DiffuseFactor", 1), 0, 1)
        clear = thing.number("TransparencyFactor", 0) * thing.numbers("TransparentColor", (1, 1, 1)).mean()
        alpha = float(np.clip(1 - clear, 0, 1))
        if alpha < 0.02:  # several exporters write 1 for what is solid, and an invisible mesh is not a character
            alpha = 1.0
        texture = self._diffuse(thing)
        if texture is not None:
            color = np.ones(3)  # in FBX the texture replaces the colour
        return matte_material(thing.name or "material", [*color, alpha], texture)

    def _diffuse(self, thing: FbxObject) -> int | None:
        for child, role in self.scene.links.get(thing.id, ()):
            texture = self.scene.objects.get(child)
            if texture is not None and texture.kind == "Texture" and role in _BASE_COLORS:
                return self._texture(texture)
        return None

    def _texture(self, texture: FbxObject) -> int | None:
        videos = self.scene.below(texture, "Video")
        names = [
            node.text(key)
            for node in (texture.node, *(video.node for video in videos))
            for key in ("RelativeFilename", "FileName", "Filename")
        ]
        key = (videos[0].id if videos else 0, names[0])
        if key not in self._textures:
            image = next(filter(None, map(_embedded, videos)), None) or self._file(names)
            self._textures[key] = None
            if image is not None and len(self.images) < MAX_IMAGES:
                self._textures[key] = len(self.images)
                self.images.append(image)
        return self._textures[key]

    def _file(self, names: list[str]) -> tuple[bytes, str] | None:
        path = self.scene.tree.path
        for name in filter(None, names):
            last = name.replace("\\", "/").rsplit("/", 1)[-1]
            for file in (name, last, f"{path.stem}.fbm/{last}", f"textures/{last}"):
                file_path: Path | None = beside(path, file)
                if file_path is not None:
                    return embeddable(file_path)
        return None


def _embedded(video: FbxObject) -> tuple[bytes, str] | None:
    node = video.node.child("Content")
    content = node.values[0] if node is not None and node.values else None
    if node is not None and isinstance(content, str):  # text files hold it as lines of base64
        try:
            content = base64.b64decode("".join(str(line) for line in node.values), validate=True)
        except (binascii.Error, ValueError):
            return None
    return embeddable(bytes(content)) if isinstance(content, memoryview | bytes) and len(content) else None
