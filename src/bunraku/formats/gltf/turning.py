"""Turn a character by right angles or scale it, and the document that it came from with it.

A document keeps its positions, normals and images as they are: what turns is the placement of its meshes, as a node
above all others would do it. So a file that is written afterwards is upright, and its materials, UVs and morph targets
are the user's own. Scaling does the same, but for formats without a unit, whose document is ours: there the positions
themselves are scaled, for readers that see nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bunraku.core.character import Character
from bunraku.errors import OptionError
from bunraku.formats.frames import BARE
from bunraku.formats.gltf.builder import scaled_mesh_document
from bunraku.formats.gltf.read import Source
from bunraku.formats.gltf.scene.mesh import MeshPart, PrimitiveData
from bunraku.formats.gltf.scene.nodes import NodeTree, posed_skins
from bunraku.geometry.axes import upright_rotation

__all__ = ["scaled", "turned"]


def turned(character: Character, up: str, front: str) -> Character:
    """The character with one of its axes up along +Y and another to the front along +Z.

    Args:
        character: Any character.
        up: The axis that is up in it now: "+x", "-x", "+y", "-y", "+z" or "-z".
        front: The axis that it faces now, at a right angle to `up`.

    Raises:
        OptionError: The two are no axes at a right angle.
    """
    rotation = upright_rotation(up, front)
    if np.array_equal(rotation, np.eye(3)):
        return character
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    rig, source = character.rig, character.source
    return replace(
        character,
        vertices=_turned_points(character.vertices, rotation),
        rig=None if rig is None else replace(rig, transforms=matrix @ rig.transforms),
        source=_turned_source(source, matrix) if isinstance(source, Source) else source,
    )


def scaled(character: Character, factor: float) -> Character:
    """The character times a factor, about the origin.

    Args:
        character: Any character.
        factor: How many metres what is one long now becomes.

    Raises:
        OptionError: Its file has rigid bodies or springs, whose sizes would stay.
    """
    if factor == 1:
        return character
    rig, source = character.rig, character.source
    if character.avatar is not None:
        raise OptionError(
            f"{character.name}: the physics of MMD and VRM files hangs on their unit; leave out the unit, or say m"
        )
    matrix = np.diag([factor, factor, factor, 1.0])
    return replace(
        character,
        vertices=character.vertices * np.float32(factor),
        rig=None if rig is None else replace(rig, transforms=matrix @ rig.transforms),
        source=_scaled_source(source, factor, matrix) if isinstance(source, Source) else source,
    )


def _scaled_source(source: Source, factor: float, matrix: np.ndarray) -> Source:
    if source.suffix not in BARE:
        return _placed_source(
            source,
            matrix,
            [replace(p, groups=_grown(p, factor), transform=_above(matrix, p.transform)) for p in source.parts],
        )
    parts = tuple(replace(part, groups=_grown(part, factor)) for part in source.parts)
    return replace(source, document=scaled_mesh_document(source.document, factor), parts=parts)


def _grown(part: MeshPart, factor: float) -> tuple[PrimitiveData, ...]:
    return tuple(replace(group, vertices=group.vertices * factor) for group in part.groups)


def _turned_points(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Exactly turned: coordinates change places and signs, and are not rounded."""
    order, signs = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1)
    return np.asarray(points[:, order] * signs.astype(points.dtype) + points.dtype.type(0))


def _turned_source(source: Source, matrix: np.ndarray) -> Source:
    return _placed_source(source, matrix, [_turned_part(part, matrix) for part in source.parts])


def _placed_source(source: Source, matrix: np.ndarray, parts: Sequence[MeshPart]) -> Source:
    """The source as a node with this matrix above all others would have it, with its parts placed so."""
    old = source.tree
    local = np.where((old.parents < 0)[:, None, None], matrix @ old.local, old.local)
    tree = NodeTree(old.parents, matrix @ old.world, old.scene, local)
    return replace(
        source,
        tree=tree,
        skins=posed_skins(source.skins, tree),
        parts=tuple(parts),
    )


def _turned_part(part: MeshPart, matrix: np.ndarray) -> MeshPart:
    groups = tuple(replace(group, vertices=_turned_points(group.vertices, matrix[:3, :3])) for group in part.groups)
    return replace(part, transform=_above(matrix, part.transform), groups=groups)


def _above(matrix: np.ndarray, transform: np.ndarray | None) -> np.ndarray | None:
    return None if transform is None else matrix @ transform
