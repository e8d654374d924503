"""Characters: a rest-pose mesh, the rig that its file may hold, and the handles that move it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bunraku.core.avatars import MmdModel, VrmModel
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import FrozenArrays
from bunraku.errors import CharacterError


@dataclass(frozen=True)
class Rig(FrozenArrays):
    """The skeleton and skin of a file.

    Args:
        names: Joint names, length J.
        parents: Parent of each joint, -1 for a root, in any order, shape (J,).
        transforms: World transform of each joint in the rest pose [m], shape (J, 4, 4).
        indices, weights: Joints that move each vertex and their shares, shape (V, M); rows sum to 1.

    Raises:
        CharacterError: Shapes disagree, or a joint does not exist.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    transforms: np.ndarray
    indices: np.ndarray
    weights: np.ndarray

    def __repr__(self) -> str:
        return f"<Rig: {len(self.names)} bones>"

    def __post_init__(self) -> None:
        count = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        self.freeze_fields("rig", {
            "parents": ((count,), np.int64), "transforms": ((count, 4, 4), np.float64),
            "indices": ((None, None), np.int32), "weights": (np.shape(self.indices), np.float32),
        })  # fmt: skip
        if count and (self.parents.max(initial=-1) >= count or self.parents.min(initial=-1) < -1):
            raise CharacterError("a rig joint names a parent that does not exist")
        if self.indices.size and (self.indices.min() < 0 or self.indices.max() >= count):
            raise CharacterError("a vertex is weighted to a joint that does not exist")

    @property
    def positions(self) -> np.ndarray:
        """Joint positions in the rest pose [m], shape (J, 3)."""
        return self.transforms[:, :3, 3]

    def dense_weights(self) -> np.ndarray:
        """Skin weights as one matrix, shape (V, J)."""
        dense = np.zeros((len(self.indices), len(self.names)), np.float32)
        np.add.at(dense, (np.arange(len(dense))[:, None], self.indices), self.weights)
        return dense


@dataclass(frozen=True)
class Character(FrozenArrays):
    """A rest-pose triangle mesh, with the rig of its file where it has one.

    Args:
        name: A short name, from the file.
        vertices: Rest positions [m], +Y up, +Z forward, shape (V, 3).
        faces: Vertex indices of each triangle, shape (F, 3).
        rig: The file's own skeleton and skin.
        colors: Colour of each vertex for previews, sRGB, shape (V, 3), uint8.
        source: The document that the mesh came from, owned by `bunraku.files`; a writer needs it to give back the
            user's materials, textures, UVs and vertex order untouched.
        avatar: What an MMD or VRM file holds besides its mesh.
        beside: Vertices that stand still beside the body, such as the ground below it, shape (V,), bool; None for none
            (`anatomy.scene.separated`).
        corrections: What a person says about it in the file beside its own (`Corrections`); None for nothing.

    Raises:
        CharacterError: No vertices, no faces, a coordinate that is not finite, an index outside the vertices, or no
            extent.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    rig: Rig | None = None
    colors: np.ndarray | None = None
    source: Any = field(default=None, compare=False)
    avatar: MmdModel | VrmModel | None = field(default=None, compare=False)
    beside: np.ndarray | None = field(default=None, compare=False)
    corrections: Any = field(default=None, compare=False)

    def __repr__(self) -> str:
        bones = "" if self.rig is None else f", {len(self.rig.names)} bones"
        return f"<Character {self.name!r}: {len(self.vertices):,} vertices{bones}>"

    def __post_init__(self) -> None:
        self.freeze_fields("", {"vertices": ((None, 3), np.float32), "faces": ((None, 3), np.int64)})
        count = len(self.vertices)
        if count == 0:
            raise CharacterError(f"{self.name}: the mesh is empty; export it again with its vertices")
        if len(self.faces) == 0:
            raise CharacterError(
                f"{self.name}: these are points without faces; make a surface of them first (Blender: remesh)"
            )
        if self.faces.min() < 0 or self.faces.max() >= count:
            worst = int(self.faces.max())
            raise CharacterError(
                f"{self.name}: a face uses vertex {worst} but there are only {count}; the file is broken"
            )
        bad = int((~np.isfinite(self.vertices).all(axis=1)).sum())
        if bad:
            raise CharacterError(
                f"{self.name}: {bad} vertices have coordinates that are not numbers; clean the mesh and export it again"
            )
        if float(np.ptp(self.vertices, axis=0).max()) <= 0:
            raise CharacterError(f"{self.name}: all vertices are at one point; there is nothing to animate")
        if self.colors is not None:
            self.freeze_fields("", {"colors": ((count, 3), np.uint8)})
        if self.rig is not None and len(self.rig.indices) != count:
            raise CharacterError(
                f"{self.name}: the rig weights {len(self.rig.indices)} vertices but the mesh has {count}"
            )

    @cached_property
    def surface(self) -> np.ndarray:
        """Which vertices of the body have faces, shape (V,), bool. Files bring stray vertices, which are not seen and
        count in no measurement.
        """
        used = np.zeros(len(self.vertices), bool)
        used[self.body_faces] = True
        used.flags.writeable = False
        return used

    @cached_property
    def areas(self) -> np.ndarray:
        """Surface area of the body that each vertex stands for [m^2], shape (V,)."""
        found = vertex_areas(self.vertices, self.body_faces)
        found.flags.writeable = False
        return found

    @property
    def body_faces(self) -> np.ndarray:
        """The faces of the body, without those beside it, shape (F', 3)."""
        return self.faces if self.beside is None else self.faces[~self.beside[self.faces].any(axis=1)]

    @property
    def height(self) -> float:
        """Extent of the surface along +Y [m], or the largest extent of something flat."""
        extent = np.ptp(self.vertices[self.surface], axis=0)
        return float(extent[1] if extent[1] > 1e-3 * extent.max() else extent.max())


@dataclass(frozen=True)
class Handles(FrozenArrays):
    """The K handles of a character (section 3.1 of TapMo); handle 0 is the root.

    Args:
        positions: Handle positions h in the rest pose [m], shape (K, 3).
        weights: Skinning weights s, shape (V, K), rows sum to 1.
        features: The mesh deformation feature f_phi, shape (448,), when the predictor made the handles.
        roles: The handle whose part each handle plays, shape (K,), where spare handles move further limbs: the second
            left knee of a spider plays that of the left knee. None where each plays its own.
        rigid: Whether nothing bends: each vertex is wholly of one handle, and handles stand where they are jointed to
            their parents.

    Raises:
        CharacterError: Shapes disagree, a value is not finite, rows do not sum to 1, or a role does not exist or is the
            root's.
    """

    positions: np.ndarray
    weights: np.ndarray
    features: np.ndarray | None = None
    roles: np.ndarray | None = None
    rigid: bool = False

    def __repr__(self) -> str:
        return f"<Handles: {len(self.positions)} of {len(self.weights):,} vertices>"

    def __post_init__(self) -> None:
        self.freeze_fields("handle", {
            "positions": ((None, 3), np.float32), "weights": ((None, len(self.positions)), np.float32),
        })  # fmt: skip
        if not np.isfinite(self.weights).all() or not np.isfinite(self.positions).all():
            raise CharacterError("handles must be finite")
        if np.abs(self.weights.sum(axis=1) - 1).max(initial=0) > 1e-3:
            raise CharacterError("the handle weights of each vertex must sum to 1")
        if self.rigid and self.weights.max(axis=1, initial=0).min(initial=1) < 1 - 1e-3:
            raise CharacterError("of a body that does not bend each vertex is of one handle")
        if self.roles is not None:
            count = len(self.positions)
            self.freeze_fields("handle", {"roles": ((count,), np.int64)})
            if count and (self.roles[0] != 0 or self.roles[1:].min(initial=1) < 1 or self.roles.max() >= count):
                raise CharacterError(
                    "handle 0 plays the root, and every other handle the part of one that exists and is not the root"
                )

    @property
    def played(self) -> np.ndarray:
        """The handle whose part each handle plays, shape (K,); without `roles` its own."""
        return np.arange(len(self.positions)) if self.roles is None else self.roles

    def check_vertices(self, count: int, name: str) -> None:
        """Raise CharacterError unless they weigh as many vertices as the character of this name has."""
        if len(self.weights) != count:
            raise CharacterError(f"the handles weigh {len(self.weights)} vertices but {name} has {count}")

    def top(self, count: int = 4) -> Handles:
        """The same handles with the largest `count` weights of each vertex, renormalised, as viewers read them."""
        if ((self.weights != 0).sum(axis=1) <= count).all():
            return self  # or what is kept and read again would differ in its last bits
        indices, shares = top_influences(self.weights, count)
        kept = np.zeros_like(self.weights)
        rows, places = np.nonzero(shares)
        kept[rows, indices[rows, places]] = shares[rows, places]
        return Handles(self.positions, kept, self.features, self.roles, self.rigid)


def written_rig(character: Character) -> Rig:
    """The rig of a character that is to be written with it; CharacterError if it has none."""
    if character.rig is None:
        raise CharacterError(f"{character.name}: there is no rig to write; make one with `bunraku.with_skeleton`")
    return character.rig


FEW = 10_000
"""Vertices whose largest weights are looked for at once."""


def top_influences(weights: np.ndarray, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """The largest `count` weights of each vertex (V, K), renormalised, largest first.

    Returns:
        Indices (V, C) int64 and shares (V, C) float32 whose rows sum to 1, C = min(count, K). A share of 0 may have any
            index, even one that occurs already.
    """
    count = min(count, weights.shape[1])
    many = (weights != 0).sum(axis=1) > count
    if len(weights) > FEW and not many.all():  # most rows have so few weights that none needs to be chosen
        rows, columns = np.nonzero(np.where(many[:, None], 0, weights))
        place = np.arange(len(rows)) - np.searchsorted(rows, rows)
        indices = np.zeros((len(weights), count), np.int64)
        indices[rows, place] = columns
        shares = np.zeros((len(weights), count), weights.dtype)
        shares[rows, place] = weights[rows, columns]
        indices[many], shares[many] = _largest(weights[many], count)
    else:
        indices, shares = _largest(weights, count)
    order = np.argsort(-shares, axis=1, kind="stable")
    indices, shares = np.take_along_axis(indices, order, axis=1), np.take_along_axis(shares, order, axis=1)
    total = shares.sum(axis=1, keepdims=True)
    return indices, (shares / np.where(total > 0, total, 1)).astype(np.float32)


def _largest(weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the largest weights of each row, and these weights, unordered."""
    indices = np.argpartition(weights, weights.shape[1] - count, axis=1)[:, weights.shape[1] - count :]
    return indices, np.take_along_axis(weights, indices, axis=1)
