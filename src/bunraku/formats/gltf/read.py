"""Read GLB, glTF and VRM: the mesh in its rest pose, the rig, and preview colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.character import Character, Rig
from bunraku.errors import CharacterError
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.scene.bind_pose import bind_pose
from bunraku.formats.gltf.scene.colors import vertex_colors
from bunraku.formats.gltf.scene.mesh import MeshPart, check_size, read_part, rigid_joints
from bunraku.formats.gltf.scene.nodes import NodeTree, SkinJoints, posed_skins, read_nodes, read_skins
from bunraku.formats.gltf.scene.vrm import read_vrm

__all__ = ["Source", "character_from_document", "read_gltf"]


MAX_COORDINATE = 1e12
"""Coordinates beyond this [m] are damage, and overflow what is computed from them."""


@dataclass(frozen=True, eq=False)
class Source:
    """Where a character came from, so that a writer can give it back untouched.

    Args:
        document: The glTF document that was read, or that stands for a file of another format.
        tree: Its nodes in the character's rest pose.
        skins: Its joints in that pose.
        parts: Its meshes where nodes and skins place them.
        index: Character vertex of each document vertex, parts, groups and vertices in order, shape (U,). Other formats
            have fewer vertices than their document where a seam splits one in two.
        suffix: The format of the file.
        moved: What took each vertex of the character from the pose of the tree to where it rests now, shape (V, 4, 4);
            None for nothing.
    """

    document: Document
    tree: NodeTree
    skins: SkinJoints
    parts: tuple[MeshPart, ...]
    index: np.ndarray
    suffix: str = ".glb"
    moved: np.ndarray | None = None


def read_gltf(path: Path, data: bytes, *, rest: str = "bind") -> Character:
    """Read a GLB, glTF or VRM file.

    The vertices are those of all primitives in node order, in world space in the rest pose; primitives of one mesh that
    share their positions share their vertices.

    Args:
        path: The file.
        data: Its bytes.
        rest: "bind" rests in the pose that the skins were bound in (see `gltf_bind`), "default" in that of the file's
            nodes, which may be the middle of a clip.

    Raises:
        FormatError: The file is broken, or needs what is not read.
        CharacterError: What it holds is no character.
    """
    return character_from_document(open_document(path, data), path.stem, rest=rest)


def character_from_document(
    document: Document, name: str, index: np.ndarray | None = None, suffix: str = ".glb", *, rest: str = "bind"
) -> Character:
    """The character that a glTF document holds.

    Args:
        document: The document.
        name: The character's name.
        index: Character vertex of each document vertex where the document repeats vertices of its file, shape (U,).
        suffix: The format of the file.
        rest: Its rest pose, "bind" or "default".

    Raises:
        FormatError: The document is broken.
        CharacterError: What it holds is no character.
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
        indices[start:stop, : group.joints.shape[1]], weights[start:stop, : group.joints.shape[1]] = (
            group.joints,
            group.weights,
        )
        start = stop
    above = tree.parents[skins.nodes]
    found = tree.nearest({node: joint for joint, node in enumerate(skins.nodes)})
    parents = np.where(above >= 0, found[above], -1)
    nodes = document.items("nodes")
    names = tuple(str(nodes[node].get("name") or f"joint_{joint}")[:200] for joint, node in enumerate(skins.nodes))
    return Rig(names, parents, tree.world[skins.nodes], indices, weights)
