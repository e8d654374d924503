"""A wardrobe character while it is made: parts with weights and materials, bones, rigid bodies and joints; at the end
an MMD model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import MMD_METRE, MmdBody, MmdBone, MmdJoint
from bunraku.formats.mmd.build import MmdFile, MmdMaterial, mmd_character
from bunraku.formats.mmd.document import LIGHT
from bunraku.formats.mmd.pmx import read_pmx_file
from bunraku.formats.mmd.pmx_write import pmx_bytes
from bunraku.geometry.surface import vertex_normals

__all__ = ["Costume", "Part", "bone_frame"]

_MIRROR = np.array([1.0, 1, -1])
_STEPS = 1024
"""Weights are multiples of 1 / 1024, so that they add up to 1 exactly in the file's 32-bit numbers."""


@dataclass(eq=False)
class Part:
    """A surface with weights and one material.

    Args:
        points: Shape (V, 3).
        faces: Shape (F, 3).
        bones: Bones of each vertex, shape (V, M).
        shares: Their shares, shape (V, M).
        material: Name of its material, or of that of each face, shape (F,).
        smooth: Whether its corners are round; otherwise each face has normals of its own.
        kind: What it is: "body" for the person and close clothes, or the piece that hangs ("skirt", "hair", ...).
    """

    points: np.ndarray
    faces: np.ndarray
    bones: np.ndarray
    shares: np.ndarray
    material: str | np.ndarray
    smooth: bool = True
    kind: str = "body"


@dataclass
class Costume:
    """Everything that a character is made of so far.

    Args:
        name: Its name.
        bones, bodies, joints: As in `MmdModel`; positions are in our frame.
        tails: Bones that a bone points to.
        parts: Its surfaces.
        colors: sRGB of each material from 0 to 1, shape (3,).
        words: What it wears, for people to read.
        facets: Whether each face has vertices and normals of its own, as loose low-polygon meshes have.
        seed: Of what differs from one piece of apparel to the next: springs, limits, where it begins to move.
        quiet: Whether little of the character is apparel: bands, tips and small pieces.
        fine: Factor on the number of vertices of what hangs, along each side.
        kind: Kind of the parts that are added next.
    """

    name: str
    bones: list[MmdBone] = field(default_factory=list)
    tails: dict[int, int] = field(default_factory=dict)
    parts: list[Part] = field(default_factory=list)
    bodies: list[MmdBody] = field(default_factory=list)
    joints: list[MmdJoint] = field(default_factory=list)
    colors: dict[str, np.ndarray] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    facets: bool = False
    seed: int = 0
    quiet: bool = False
    fine: float = 1.0
    kind: str = "body"

    def bone_index(self, name: str) -> int:
        """Index of the bone with this name.

        Raises:
            KeyError: There is none.
        """
        for index, bone in enumerate(self.bones):
            if bone.name == name:
                return index
        raise KeyError(name)

    def bone(self, bone: MmdBone, tail: int | None = None) -> int:
        """Add a bone; `tail` is the bone that it points to."""
        self.bones.append(bone)
        if tail is not None:
            self.tails[len(self.bones) - 1] = tail
        return len(self.bones) - 1

    def body(self, body: MmdBody) -> int:
        """Add a rigid body."""
        self.bodies.append(body)
        return len(self.bodies) - 1

    def collider(self, bone: int) -> int:
        """The first kinematic body of a bone, that apparel hangs on."""
        return next(index for index, body in enumerate(self.bodies) if body.bone == bone and not body.dynamic)

    def add(
        self,
        points: np.ndarray,
        faces: np.ndarray,
        bones: np.ndarray | int,
        shares: np.ndarray | int,
        material: str | np.ndarray,
    ) -> None:
        """Add a surface, less the vertices that it does not use.

        Args:
            points: Shape (V, 3).
            faces: Shape (F, 3).
            bones: Of each vertex, shape (V, M), or the one bone that all go with.
            shares: Their shares, shape (V, M), or 1.
            material: Of all faces, or of each, shape (F,).
        """
        if not len(faces):
            return
        if np.ndim(bones) == 0:
            bones, shares = np.full((len(points), 1), bones), np.ones((len(points), 1))
        if not isinstance(material, str):
            material = np.broadcast_to(material, len(faces))
        used, corners = np.unique(faces, return_inverse=True)
        bones, shares = np.asarray(bones), np.asarray(shares, float)
        self.parts.append(
            Part(
                np.asarray(points, float)[used],
                corners.reshape(-1, 3),
                bones[used],
                shares[used],
                material,
                not self.facets,
                self.kind,
            )
        )

    def character(self) -> Character:
        """The character: what reading the file of this model gives."""
        path = Path(f"{self.name}.pmx")
        return mmd_character(path, read_pmx_file(path, pmx_bytes(self.file())))

    def file(self) -> MmdFile:
        """What the file of this model says: one mesh, its triangles sorted by material."""
        meshes: list[tuple[np.ndarray, ...]] = []  # points, normals, faces, bones, shares and materials of the faces
        for part in self.parts:
            labels = np.broadcast_to(part.material, len(part.faces))
            if part.smooth:
                origin, faces = _split(part.faces, labels)
                normals = vertex_normals(part.points, part.faces)[origin]
            else:
                origin, faces = part.faces.reshape(-1), np.arange(part.faces.size).reshape(-1, 3)
                normals = vertex_normals(part.points[origin], faces)
            meshes.append(
                (part.points[origin], normals, faces, *_quantized(part.bones[origin], part.shares[origin]), labels)
            )
        starts = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
        labels = np.concatenate([mesh[5] for mesh in meshes])
        names = list(dict.fromkeys(labels.tolist()))
        order = np.argsort([names.index(label) for label in labels.tolist()], kind="stable")
        triangles = np.concatenate([mesh[2] + start for mesh, start in zip(meshes, starts, strict=False)])[order]
        points, normals, bones, shares = (np.concatenate([mesh[at] for mesh in meshes]) for at in (0, 1, 3, 4))
        out = MmdFile("PMX 2.0", self.name, ", ".join(self.words))
        out.positions, out.normals = points * _MIRROR / MMD_METRE, normals * _MIRROR
        out.uvs, out.sdef = np.zeros((len(points), 2)), np.zeros((len(points), 3, 3))
        out.indices, out.weights = bones, shares
        out.deforms = np.array([0, 0, 1, 2, 2], np.uint8)[(shares > 0).sum(axis=1)]
        out.triangles = triangles[:, ::-1]
        for name in names:
            color = self.colors[name]
            diffuse = np.array([*color, 1], np.float32).astype(float)
            out.materials.append(
                MmdMaterial(name, diffuse, color * (1 - LIGHT), True, "", 3 * int((labels == name).sum()))
            )
        out.bones, out.tails, out.bodies, out.joints = self.bones, self.tails, self.bodies, self.joints
        return out


def _split(faces: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A vertex for each material that it has: which vertex each was, shape (W,), and the faces, shape (F, 3)."""
    names, kind = np.unique(labels, return_inverse=True)
    keys, corners = np.unique(faces * len(names) + kind.reshape(-1, 1), return_inverse=True)
    return keys // len(names), corners.reshape(-1, 3)


def _quantized(bones: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four largest shares of each vertex, one a bone, in whole steps, largest first; shape (V, 4) each."""
    count = len(bones)
    order = np.argsort(bones, axis=1, kind="stable")
    index, value = np.take_along_axis(bones, order, 1), np.take_along_axis(shares, order, 1).copy()
    for column in range(index.shape[1] - 1, 0, -1):  # the same bone named twice
        same = index[:, column] == index[:, column - 1]
        value[same, column - 1] += value[same, column]
        value[same, column] = 0
    order = np.argsort(-value, axis=1, kind="stable")[:, :4]
    index, value = np.take_along_axis(index, order, 1), np.take_along_axis(value, order, 1)
    value = np.where(value > 0.004, value, 0)
    steps = np.rint(value / value.sum(axis=1, keepdims=True) * _STEPS).astype(np.int64)
    steps[:, 0] += _STEPS - steps.sum(axis=1)
    full, out = np.full((count, 4), -1, np.int64), np.zeros((count, 4))
    full[:, : index.shape[1]], out[:, : index.shape[1]] = np.where(steps > 0, index, -1), steps / _STEPS
    return full, out


def bone_frame(down: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Axes of a link of apparel, columns, shape (3, 3): Y back along the link, Z outward, X to the side.

    A positive turn about X swings its end inwards.
    """
    y = -down / max(float(np.linalg.norm(down)), 1e-9)
    x = np.cross(y, outward)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(y, [0.0, 0, 1]) if abs(y[2]) < 0.9 else np.cross(y, [1.0, 0, 0])
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)
