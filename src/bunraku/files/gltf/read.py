"""Read GLB, glTF and VRM as a character, and rotate or scale a character together with its document."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.core.character import Character, Rig
from bunraku.core.geometry.axes import BARE, upright_rotation
from bunraku.errors import CharacterError, OptionError
from bunraku.files.gltf.colors import vertex_colors
from bunraku.files.gltf.document import Document, scaled_mesh_document
from bunraku.files.gltf.mesh import MeshPart, check_size, read_part, rigid_joints
from bunraku.files.gltf.nodes import NodeTree, SkinJoints, bind_pose, posed_skins, read_nodes, read_skins
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.vrm import read_vrm

MAX_COORDINATE = 1e12
"""Coordinates beyond this [m] are damage, and overflow what is computed from them."""


@dataclass(frozen=True, eq=False)
class Source:
    """Where a character came from, so that a writer can give it back untouched."""

    document: Document  # the glTF document that was read, or that stands for a file of another format
    tree: NodeTree  # its nodes in the character's rest pose
    skins: SkinJoints  # its joints in that pose
    parts: tuple[MeshPart, ...]  # its meshes where nodes and skins place them
    # Character vertex of each document vertex, parts, groups and vertices in order, shape (U,). Other formats have
    # fewer vertices than their document where a seam splits one in two.
    index: np.ndarray
    suffix: str = ".glb"  # the format of the file
    # Transform of each vertex of the character from the pose of the tree to its rest position, shape (V, 4, 4); None
    # for none.
    moved: np.ndarray | None = None

    def fits(self, character: Character) -> bool:
        """Whether the document has all vertices of a character."""
        return len(self.index) > 0 and int(self.index.max()) + 1 == len(character.vertices)

    def placed(self) -> Iterator[tuple[MeshPart, np.ndarray]]:
        """The parts that have vertices, each with the character's vertex of each of its own."""
        start = 0
        for part in self.parts:
            stop = start + sum(len(group.vertices) for group in part.groups)
            if stop > start:
                yield part, self.index[start:stop]
            start = stop


def read_gltf(path: Path, data: bytes, *, rest: str = "bind") -> Character:
    """Read a GLB, glTF or VRM file, which rests as in `load_character`.

    The vertices are those of all primitives in node order, in world space in the rest pose; primitives of one mesh that
    share their positions share their vertices. FormatError if the file is broken, or needs what is not read;
    CharacterError if what it holds is no character.
    """
    return character_from_document(open_document(path, data), path.stem, rest=rest)


def character_from_document(
    document: Document, name: str, index: np.ndarray | None = None, suffix: str = ".glb", *, rest: str = "bind"
) -> Character:
    """The character of a glTF document, resting in its "bind" or "default" pose. `index` is the character's vertex of
    each document vertex where the document repeats vertices of its file, shape (U,). FormatError if the document is
    broken; CharacterError if what it holds is no character.
    """
    tree = read_nodes(document)
    skins = read_skins(document, tree)
    if rest == "bind" and skins.nodes:
        tree = bind_pose(document, tree, skins)
        skins = posed_skins(skins, tree)
    nodes = document.items("nodes")
    check_size(document, tree.scene)
    carriers = rigid_joints(tree, skins)
    parts = tuple(
        read_part(document, tree, skins, node, int(carriers[node])) for node in tree.scene if "mesh" in nodes[node]
    )
    groups = [group for part in parts for group in part.groups]
    starts = np.cumsum([0, *(len(group.vertices) for group in groups)])
    vertices = np.concatenate([group.vertices for group in groups]) if groups else np.zeros((0, 3))
    with np.errstate(over="ignore"):
        vertices = vertices.astype(np.float32)
    farthest = float(np.abs(vertices).max(initial=0))
    if np.isfinite(farthest) and farthest > MAX_COORDINATE:
        raise CharacterError(f"{name}: its coordinates reach {farthest:.0e} m; scale the mesh down or export it again")
    triangles = np.empty((sum(len(some) for group in groups for some in group.triangles), 3), np.int64)
    row = 0
    for group, start in zip(groups, starts, strict=False):
        for some in group.triangles:
            np.add(some, start, out=triangles[row : row + len(some)])
            row += len(some)
    colors = vertex_colors(document, parts, len(vertices))
    rig = _rig(document, tree, skins, parts) if skins.nodes and groups else None
    if index is None:
        index = np.arange(len(vertices))
    else:
        first = np.unique(index, return_index=True)[1]
        vertices, colors, triangles = vertices[first], colors[first], index[triangles]
        if rig is not None:
            rig = Rig(rig.names, rig.parents, rig.transforms, rig.indices[first], rig.weights[first])
    source = Source(document, tree, skins, parts, index, suffix)
    avatar = read_vrm(document) if document.tree.get("extensions") else None
    return Character(name, vertices, triangles, rig, colors, source, avatar)


def _rig(document: Document, tree: NodeTree, skins: SkinJoints, parts: tuple[MeshPart, ...]) -> Rig:
    groups = [group for part in parts for group in part.groups]
    width = max(group.joints.shape[1] for group in groups)
    count = sum(len(group.vertices) for group in groups)
    indices, weights, start = np.zeros((count, width), np.int32), np.zeros((count, width), np.float32), 0
    for group in groups:
        stop = start + len(group.vertices)
        held = slice(start, stop), slice(group.joints.shape[1])
        indices[held], weights[held] = group.joints, group.weights
        start = stop
    above = tree.parents[skins.nodes]
    joints = tree.nearest({node: joint for joint, node in enumerate(skins.nodes)})
    parents = np.where(above >= 0, joints[above], -1)
    nodes = document.items("nodes")
    names = tuple(str(nodes[node].get("name") or f"joint_{joint}")[:200] for joint, node in enumerate(skins.nodes))
    return Rig(names, parents, tree.world[skins.nodes], indices, weights)


def rotated(character: Character, up: str, front: str) -> Character:
    """The character with the axis `up` ("+x", "-x", "+y", "-y", "+z" or "-z") rotated to +Y and the axis `front` to +Z.
    OptionError if the two are no axes at a right angle.
    """
    rotation = upright_rotation(up, front)
    said = character.corrections
    if said is not None and said.has_axes:
        character = replace(character, corrections=said.standing())
    if np.array_equal(rotation, np.eye(3)):
        return character
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    rig, source = character.rig, character.source
    if isinstance(source, Source):
        source = _placed_source(source, matrix, _moved(source.parts, lambda points: _turned_points(points, rotation)))
    return replace(
        character,
        vertices=_turned_points(character.vertices, rotation),
        rig=None if rig is None else replace(rig, transforms=matrix @ rig.transforms),
        source=source,
    )


def scaled(character: Character, factor: float) -> Character:
    """The character times a factor, about the origin. OptionError if its file has rigid bodies or springs, whose sizes
    would stay.
    """
    if factor == 1:
        return character
    rig, source = character.rig, character.source
    if character.avatar is not None:
        raise OptionError(
            f"{character.name}: the physics of MMD and VRM files depends on their unit; leave out the unit, or say m"
        )
    matrix = np.diag([factor, factor, factor, 1.0])
    return replace(
        character,
        vertices=character.vertices * np.float32(factor),
        rig=None if rig is None else replace(rig, transforms=matrix @ rig.transforms),
        source=_scaled_source(source, factor, matrix) if isinstance(source, Source) else source,
    )


def _scaled_source(source: Source, factor: float, matrix: np.ndarray) -> Source:
    parts = _moved(source.parts, lambda points: points * factor)
    if source.suffix in BARE:
        return replace(source, document=scaled_mesh_document(source.document, factor), parts=parts)
    return _placed_source(source, matrix, parts)


def _moved(parts: Sequence[MeshPart], move: Callable[[np.ndarray], np.ndarray]) -> tuple[MeshPart, ...]:
    """Parts with their vertices moved."""
    return tuple(
        replace(part, groups=tuple(replace(group, vertices=move(group.vertices)) for group in part.groups))
        for part in parts
    )


def _turned_points(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Exactly rotated: coordinates swap and change sign, and are not rounded."""
    order, signs = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1)
    return np.asarray(points[:, order] * signs.astype(points.dtype) + points.dtype.type(0))


def _placed_source(source: Source, matrix: np.ndarray, parts: Sequence[MeshPart]) -> Source:
    """The source as it is below a node with this matrix, with parts whose vertices are placed so."""
    old = source.tree
    local = np.where((old.parents < 0)[:, None, None], matrix @ old.local, old.local)
    tree = NodeTree(old.parents, matrix @ old.world, old.scene, local)
    moved = (replace(part, transform=None if part.transform is None else matrix @ part.transform) for part in parts)
    return replace(source, tree=tree, skins=posed_skins(source.skins, tree), parts=tuple(moved))
