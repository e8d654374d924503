"""The rigid blocks that a file is made of: mesh nodes without a skin, or vertices that have one joint each."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from bunraku.core.character import Character
from bunraku.formats.gltf.read import Source
from bunraku.geometry.graph import clean_mesh
from bunraku.skeletons.bone_words import block_of_name

__all__ = ["Blocks", "find_blocks"]

LEAST, MOST = 3, 100  # blocks of a figure
WHOLE = 0.999  # share of a vertex that is of one joint
COAT, PEER = 0.5, 0.25  # share of a block's box within another's, and of the other's, of what are coats of one part
CUT = 0.1  # share of the rims' edges that two blocks have in common, from which on they are cuts through one surface


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a character.

    Args:
        label: Block of each vertex, -1 for those without faces, shape (V,).
        names: What the file calls them, length B.
        origins: Where their nodes stand, about which their authors turned them [m], shape (B, 3).
        above: The block whose node is above each in the file, -1 for none, shape (B,).
    """

    label: np.ndarray
    names: tuple[str, ...]
    origins: np.ndarray
    above: np.ndarray


def find_blocks(character: Character) -> Blocks | None:
    """The blocks of a character; None where it has too few, or one surface goes over several: also where it was
    cut into several nodes, whose rims then fit together.
    """
    found = _of_joints(character) if character.rig is not None else _of_nodes(character)
    if found is None or len(found.names) > MOST:
        return None
    found = _without_coats(character, found)
    if len(found.names) < LEAST:
        return None
    faces = found.label[character.faces]
    return found if (faces == faces[:, :1]).all() and _fitting(character, faces[:, 0]) < CUT else None


def _without_coats(character: Character, blocks: Blocks) -> Blocks:
    """The same with what lies in one place made one block, where the names differ by a number alone: a sheep's leg and
    the wool around it.
    """
    names = [re.sub(r"[\d_. ]+$", "", name).lower() for name in blocks.names]
    boxes = [character.vertices[blocks.label == block] for block in range(len(names))]
    low, high = np.array([box.min(axis=0) for box in boxes]), np.array([box.max(axis=0) for box in boxes])
    size = np.maximum(high - low, 1e-3 * float((high.max(axis=0) - low.min(axis=0)).max()))
    first = np.arange(len(names))
    for one, name in enumerate(names):
        for other in range(one):
            shared = np.prod(np.clip(np.minimum(high[one], high[other]) - np.maximum(low[one], low[other]), 0, None))
            less, more = sorted((size[one].prod(), size[other].prod()))
            if name and name == names[other] and shared > max(COAT * less, PEER * more):
                first[one] = first[other]
                break
    kept, number = np.unique(first, return_inverse=True)
    new = np.append(number, -1)  # the last entry is that of vertices without a block, and of none above
    above = new[blocks.above[kept]]
    above[above == np.arange(len(kept))] = -1
    return Blocks(new[blocks.label], tuple(blocks.names[block] for block in kept), blocks.origins[kept], above)


def _fitting(character: Character, owner: np.ndarray) -> float:
    """Share of the edges on the rims of blocks that lie on the rims of two; 0 where all blocks are closed.

    Args:
        character: V vertices, F faces.
        owner: Block of each face, shape (F,).
    """
    clean = clean_mesh(character.vertices, character.faces)
    corners = clean.index[character.faces]
    ends = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    real = ends[:, 0] != ends[:, 1]
    key, times = np.unique(
        np.stack([ends[real, 0] * len(clean.vertices) + ends[real, 1], np.tile(owner, 3)[real]]), axis=1,
        return_counts=True,
    )  # fmt: skip
    sides = np.unique(key[0, times == 1], return_counts=True)[1]
    return float(sides[sides > 1].sum() / max(sides.sum(), 1))


def _of_joints(character: Character) -> Blocks | None:
    rig = character.rig
    assert rig is not None
    if rig.weights[character.surface].max(axis=1).min() < WHOLE:
        return None
    rows = np.arange(len(rig.indices))
    joint = np.where(character.surface, rig.indices[rows, rig.weights.argmax(axis=1)], -1)
    used = np.unique(joint[joint >= 0])
    return _numbered(joint, used, rig.names, rig.positions, rig.parents)


def _of_nodes(character: Character) -> Blocks | None:
    source = character.source
    if not isinstance(source, Source) or not len(source.index):
        return None
    if int(source.index.max()) + 1 != len(character.vertices):
        return None
    nodes, parents = source.document.items("nodes"), source.tree.parents
    names = [str(node.get("name") or "")[:200] for node in nodes]
    label, start = np.full(len(character.vertices), -1), 0
    moved = np.tile(np.eye(4), (len(nodes), 1, 1))
    for part in source.parts:
        stop = start + sum(len(group.vertices) for group in part.groups)
        index = source.index[start:stop]
        start = stop
        if not len(index):
            continue
        owner = _named_above(part.node, names, parents, {other.node for other in source.parts})
        if (np.isin(label[index], [-1, owner], invert=True)).any():
            return None  # a seam was closed: what files call parts is one surface
        label[index] = owner
        if source.moved is not None:
            moved[owner] = source.moved[index[0]]
    label[~character.surface] = -1
    origins = np.einsum("nij,nj->ni", moved[:, :3, :3], source.tree.world[:, :3, 3]) + moved[:, :3, 3]
    return _numbered(label, np.unique(label[label >= 0]), names, origins, parents)


def _named_above(node: int, names: list[str], parents: np.ndarray, meshes: set[int]) -> int:
    """The node that names a mesh: its own, or one without a mesh above it, where that is understood and its own is
    not.
    """
    above = node
    while block_of_name(names[above])[0] == "":
        above = int(parents[above])
        if above < 0 or above in meshes:
            return node
    return above if block_of_name(names[above])[0] in ("arm", "leg", "front leg", "head", "tail", "wing") else node


def _numbered(
    label: np.ndarray, used: np.ndarray, names: list[str] | tuple[str, ...], origins: np.ndarray, parents: np.ndarray
) -> Blocks:
    number = {int(node): block for block, node in enumerate(used)}
    above = []
    for node in used:
        other, steps = int(parents[node]), 0
        while other >= 0 and other not in number and steps < len(parents):
            other, steps = int(parents[other]), steps + 1
        above.append(number.get(other, -1))
    block_of = np.full(max(len(names), 1) + 1, -1)  # the last entry is that of vertices without one
    block_of[used] = np.arange(len(used))
    return Blocks(block_of[label], tuple(names[int(node)] for node in used), origins[used], np.array(above))
