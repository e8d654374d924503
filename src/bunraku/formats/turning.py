"""Turn a character by right angles, and the document that it came from with it.

A document keeps its positions, normals and images as they are: what turns is the placement of its meshes, as a node
above all others would do it. So a file that is written afterwards is upright, and its materials, UVs and morph targets
are the user's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.gltf.mesh import MeshPart
from bunraku.formats.gltf.nodes import NodeTree, posed_skins
from bunraku.formats.gltf.read import Source
from bunraku.geometry.axes import upright_rotation

__all__ = ["turned"]


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


def _turned_points(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Exactly turned: coordinates change places and signs, and are not rounded."""
    order, signs = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1)
    return np.asarray(points[:, order] * signs.astype(points.dtype) + points.dtype.type(0))


def _turned_source(source: Source, matrix: np.ndarray) -> Source:
    old = source.tree
    local = np.where((old.parents < 0)[:, None, None], matrix @ old.local, old.local)
    tree = NodeTree(old.parents, matrix @ old.world, old.scene, local)
    return replace(
        source,
        tree=tree,
        skins=posed_skins(source.skins, tree),
        parts=tuple(_turned_part(part, matrix) for part in source.parts),
    )


def _turned_part(part: MeshPart, matrix: np.ndarray) -> MeshPart:
    groups = tuple(replace(group, vertices=_turned_points(group.vertices, matrix[:3, :3])) for group in part.groups)
    return replace(part, transform=None if part.transform is None else matrix @ part.transform, groups=groups)
