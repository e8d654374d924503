"""The objects of an FBX file, their connections, axes and units, and the transforms of its models."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bunraku.files.fbx.nodes import BROKEN, FbxNode, FbxTree

MAX_MODELS = 50_000
TICKS = 46_186_158_000
"""Units of an FBX time in a second."""


@dataclass(frozen=True, eq=False)
class FbxObject:
    """An object of the file."""

    id: int
    kind: str  # `Model`, `Geometry`, `Deformer`, ...
    subtype: str  # `Mesh`, `LimbNode`, `Skin`, `Cluster`, ...
    name: str
    node: FbxNode
    properties: dict[str, list[Any]]  # its own properties and those of its kind's template

    def numbers(self, name: str, default: tuple[float, ...]) -> np.ndarray:
        """A property as numbers, shape (len(default),); the default where it has none that are finite."""
        values = self.properties.get(name, [])[: len(default)]
        if len(values) < len(default) or not all(isinstance(value, (int, float)) for value in values):
            return np.array(default, float)
        out = np.array(values, float)
        return out if np.isfinite(out).all() else np.array(default, float)

    def number(self, name: str, default: float) -> float:
        """A property that is one number."""
        return float(self.numbers(name, (default,))[0])


@dataclass(frozen=True)
class Frame:
    """The frame and unit of a file."""

    # rotates its vectors into ours (+Y up, +Z forward), and mirrors those of a left-handed file, shape (3, 3)
    axes: np.ndarray
    metres: float  # its unit of length [m]
    # up, front: its up and front axes, for messages
    up: str
    front: str

    @property
    def hand(self) -> np.ndarray:
        """The identity, or a mirror of Z in the local frames of a left-handed file, shape (3, 3)."""
        return np.diag([1.0, 1, np.sign(np.linalg.det(self.axes))])

    def world(self, matrices: np.ndarray) -> np.ndarray:
        """World transforms of the file in our frame [m], with local frames of the same size, shape (..., 4, 4)."""
        out = np.array(matrices, float)
        out[..., :3, :3] = self.axes @ matrices[..., :3, :3] @ self.hand
        out[..., :3, 3] = self.metres * (matrices[..., :3, 3] @ self.axes.T)
        return out


@dataclass(frozen=True, eq=False)
class FbxScene:
    """The objects of an FBX file."""

    tree: FbxTree
    objects: dict[int, FbxObject]  # by number
    # for each object, those connected below it, with the property that they drive ("" for none)
    links: dict[int, list[tuple[int, str]]]
    owners: dict[int, list[tuple[int, str]]]  # for each object, those above it, likewise
    models: tuple[FbxObject, ...]  # the models, parents first
    parents: np.ndarray  # index of each model's parent among them, -1 for none

    def below(self, owner: FbxObject, kind: str, subtype: str = "") -> list[FbxObject]:
        """Objects of a kind that are connected below one, in the order of the file."""
        ends = (self.objects.get(other) for other, _ in self.links.get(owner.id, ()))
        return [other for other in ends if other is not None and other.kind == kind and subtype in ("", other.subtype)]

    def above(self, model: int, among: Container[int]) -> int:
        """The nearest of some models above one, -1 for none."""
        model = int(self.parents[model])
        while model >= 0 and model not in among:
            model = int(self.parents[model])
        return model

    def of_kind(self, kind: str) -> list[FbxObject]:
        """All objects of a kind, in the order of the file."""
        return [thing for thing in self.objects.values() if thing.kind == kind]

    @cached_property
    def indices(self) -> dict[int, int]:
        """Index of each model by its number."""
        return {model.id: index for index, model in enumerate(self.models)}

    @cached_property
    def frame(self) -> Frame:
        """The frame and unit that the file states; Y up and centimetres where it states none that make sense."""
        settings = FbxObject(0, "", "", "", FbxNode(""), _properties(self.tree.section("GlobalSettings")))
        axes, names = np.zeros((3, 3)), []
        for row, (name, default) in enumerate((("CoordAxis", 0), ("UpAxis", 1), ("FrontAxis", 2))):
            axis, sign = int(settings.number(name, default)), -1.0 if settings.number(f"{name}Sign", 1) < 0 else 1.0
            if 0 <= axis <= 2:
                axes[row, axis] = sign
                names.append(f"{'-' if sign < 0 else '+'}{'XYZ'[axis]}")
        if abs(np.linalg.det(axes)) < 0.5:
            axes, names = np.eye(3), ["+X", "+Y", "+Z"]
        unit = settings.number("UnitScaleFactor", 1)
        return Frame(axes, 0.01 * (unit if 1e-6 <= unit <= 1e6 else 1.0), names[1], names[2])


def read_scene(tree: FbxTree) -> FbxScene:
    """The objects of a file and their connections. FormatError if there are too many models, or they form a cycle."""
    templates = {}
    for entry in tree.section("Definitions").all("ObjectType"):
        template = entry.child("PropertyTemplate")
        if template is not None and entry.values:
            templates[str(entry.values[0])] = _properties(template)
    objects: dict[int, FbxObject] = {}
    for node in tree.section("Objects").children:
        if len(node.values) >= 3 and type(node.values[0]) is int and node.values[0] != 0:
            properties = {**templates.get(node.name, {}), **_properties(node)}
            number, label, subtype = node.values[:3]
            objects[number] = FbxObject(number, node.name, str(subtype), _name(str(label)), node, properties)
    links: dict[int, list[tuple[int, str]]] = {}
    owners: dict[int, list[tuple[int, str]]] = {}
    for link in tree.section("Connections").all("C"):
        if len(link.values) >= 3 and type(link.values[1]) is int and type(link.values[2]) is int:
            child, owner = link.values[1:3]
            role = str(link.values[3]) if len(link.values) > 3 else ""
            links.setdefault(owner, []).append((child, role))
            owners.setdefault(child, []).append((owner, role))
    models, parents = _hierarchy(tree, objects, owners)
    return FbxScene(tree, objects, links, owners, models, parents)


def _hierarchy(
    tree: FbxTree, objects: dict[int, FbxObject], owners: dict[int, list[tuple[int, str]]]
) -> tuple[tuple[FbxObject, ...], np.ndarray]:
    """The models with parents first, and the parent of each."""
    models = [thing for thing in objects.values() if thing.kind == "Model"]
    if len(models) > MAX_MODELS:
        tree.fail(f"it has {len(models):,} objects but at most {MAX_MODELS:,} are read; export fewer")
    above: dict[int, int] = {}
    children: dict[int, list[FbxObject]] = {}
    for model in models:
        plain = (owner for owner, what in owners.get(model.id, ()) if not what and owner in objects)
        above[model.id] = parent = next((owner for owner in plain if objects[owner].kind == "Model"), 0)
        children.setdefault(parent, []).append(model)
    ordered = list(children.get(0, []))
    for model in ordered:
        ordered.extend(children.get(model.id, []))
    if len(ordered) != len(models):
        tree.fail(f"its objects form a cycle; {BROKEN}")
    indices = {model.id: index for index, model in enumerate(ordered)}
    return tuple(ordered), np.array([indices.get(above[model.id], -1) for model in ordered], int)


def _properties(node: FbxNode) -> dict[str, list[Any]]:
    table = node.child("Properties70")
    if table is None:
        return {}
    return {str(entry.values[0]): entry.values[4:] for entry in table.all("P") if len(entry.values) > 4}


def _name(text: str) -> str:
    """The name of an object: "Hips" of "Hips\\x00\\x01Model" (binary) and of "Model::Hips" (text)."""
    binary = "\0" in text
    return (text.split("\0", 1)[0] if binary else text.split("::", 1)[-1])[:200]


PROPERTIES: dict[str, tuple[float, float, float]] = {
    "Lcl Translation": (0, 0, 0),
    "Lcl Rotation": (0, 0, 0),
    "Lcl Scaling": (1, 1, 1),
}
"""The properties that clips move, with their defaults; rotations in degrees."""

_ORDERS = ("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX", "XYZ")  # the first letter turns first; spheric XYZ is read as XYZ

Values = dict[tuple[int, str], np.ndarray]
"""Values of (model, property) at N moments, shape (N, 3)."""


@dataclass(frozen=True)
class _World:
    matrix: np.ndarray  # (N, 4, 4), or (1, 4, 4) of what never moves
    rotation: np.ndarray  # (N, 3, 3), of all rotations above and here
    scale: np.ndarray  # (N, 3), own


def euler_matrices(degrees: np.ndarray, order: str = "XYZ") -> np.ndarray:
    """Rotations of Euler angles about fixed axes X, Y, Z in turn [degrees], shape (..., 3) -> (..., 3, 3)."""
    out = np.eye(3)
    for axis in order:
        k = "XYZ".index(axis)
        i, j = (k + 1) % 3, (k + 2) % 3
        angle = np.radians(degrees[..., k])
        turn = np.zeros((*degrees.shape, 3))
        turn[..., k, k] = 1
        turn[..., i, i] = turn[..., j, j] = np.cos(angle)
        turn[..., j, i], turn[..., i, j] = np.sin(angle), -np.sin(angle)
        out = turn @ out
    return out


def geometric_matrix(model: FbxObject) -> np.ndarray:
    """The transform of a model's mesh that its children do not have, shape (4, 4)."""
    out = np.eye(4)
    scale = model.numbers("GeometricScaling", (1, 1, 1))
    out[:3, :3] = euler_matrices(model.numbers("GeometricRotation", (0, 0, 0))) * scale
    out[:3, 3] = model.numbers("GeometricTranslation", (0, 0, 0))
    return out


def default_world(scene: FbxScene) -> np.ndarray:
    """World transforms of all models in the default pose, in the file's frame and unit, shape (M, 4, 4)."""
    return np.concatenate([np.zeros((0, 4, 4)), *world_matrices(scene, {}, list(range(len(scene.models))))])


def world_matrices(scene: FbxScene, values: Values, chosen: list[int]) -> list[np.ndarray]:
    """World transforms of chosen models in the file's frame and unit, where some properties have N values each: shape
    (N, 4, 4), or (1, 4, 4) for a model that never moves.
    """
    needed = set()
    for model in chosen:
        while model >= 0 and model not in needed:
            needed.add(model)
            model = int(scene.parents[model])
    worlds: dict[int, _World] = {}
    for model in sorted(needed):  # parents come first
        parent = int(scene.parents[model])
        worlds[model] = _placed(scene.models[model], model, values, worlds[parent] if parent >= 0 else None)
    return [worlds[model].matrix for model in chosen]


def _placed(model: FbxObject, index: int, values: Values, parent: _World | None) -> _World:
    moving = [values.get((index, name), model.numbers(name, default)[None]) for name, default in PROPERTIES.items()]
    translation, degrees, scale = moving
    if model.number("RotationActive", 0) and not model.number("RotationSpaceForLimitOnly", 0):
        order = _ORDERS[min(max(int(model.number("RotationOrder", 0)), 0), 6)]
        before = euler_matrices(model.numbers("PreRotation", (0, 0, 0)))
        after = euler_matrices(model.numbers("PostRotation", (0, 0, 0))).T
    else:
        order, before, after = "XYZ", np.eye(3), np.eye(3)
    rotation = before @ euler_matrices(degrees, order) @ after
    turn_offset, turn_pivot, scale_offset, scale_pivot = (
        model.numbers(name, (0, 0, 0)) for name in ("RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot")
    )
    inner = scale_offset + scale_pivot - turn_pivot - scale * scale_pivot
    count = max(len(translation), len(rotation), len(scale), 1 if parent is None else len(parent.matrix))
    matrix = np.zeros((count, 4, 4))
    matrix[:, 3, 3] = 1
    matrix[:, :3, 3] = translation + turn_offset + turn_pivot + np.einsum("nij,nj->ni", *_same(rotation, inner))
    if parent is None:
        matrix[:, :3, :3] = rotation * scale[:, None, :]
        return _World(matrix, rotation, scale)
    carried = np.einsum("nij,nj->ni", *_same(parent.matrix[:, :3, :3], matrix[:, :3, 3]))
    matrix[:, :3, 3] = carried + parent.matrix[:, :3, 3]
    inherit = int(model.number("InheritType", 1))
    if inherit == 1:
        matrix[:, :3, :3] = parent.matrix[:, :3, :3] @ (rotation * scale[:, None, :])
    else:  # scales of parents come after the own rotation (0), or those of the very parent not at all (2)
        above = np.swapaxes(parent.rotation, 1, 2) @ parent.matrix[:, :3, :3]
        if inherit == 2:
            above = above / np.where(np.abs(parent.scale) > 1e-12, parent.scale, 1)[:, None, :]
        matrix[:, :3, :3] = parent.rotation @ rotation @ above * scale[:, None, :]
    return _World(matrix, parent.rotation @ rotation, scale)


def _same(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both with as many rows: one of a single row is repeated."""
    count = max(len(first), len(second))
    return np.broadcast_to(first, (count, *first.shape[1:])), np.broadcast_to(second, (count, *second.shape[1:]))
