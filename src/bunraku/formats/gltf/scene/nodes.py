"""The node tree of a glTF document: world transforms, the default scene, and the joints of all skins as one list."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bunraku.formats.gltf.container.document import Document
from bunraku.geometry.rotations import matrix_from_quaternion

__all__ = ["NodeTree", "SkinJoints", "posed_skins", "read_nodes", "read_skins"]

MAX_NODES = 100_000
MAX_SLOTS = 300_000  # joints of all skins: many skins may name the same ones, and each takes two matrices


@dataclass(frozen=True)
class NodeTree:
    """The nodes of a document in a pose: the default one as `read_nodes` gives it.

    Args:
        parents: Parent of each node, shape (M,); -1 for a root.
        world: World transform of each node in this pose [m], shape (M, 4, 4).
        scene: Nodes of the default scene, ascending.
        local: Transform of each node in its parent as the file says, whatever the pose, shape (M, 4, 4).
    """

    parents: np.ndarray
    world: np.ndarray
    scene: list[int]
    local: np.ndarray

    @cached_property
    def order(self) -> list[int]:
        """All nodes, each after its parent."""
        below: list[list[int]] = [[] for _ in self.parents]
        order: list[int] = []
        for node, parent in enumerate(self.parents.tolist()):
            (below[parent] if parent >= 0 else order).append(node)
        for node in order:
            order.extend(below[node])
        return order

    def nearest(self, chosen: dict[int, int]) -> np.ndarray:
        """What is chosen for the nearest of the chosen nodes at or above each node, -1 for none, shape (M,)."""
        parents = self.parents.tolist()
        found = [-1] * len(parents)
        for node in self.order:
            found[node] = chosen[node] if node in chosen else found[parents[node]] if parents[node] >= 0 else -1
        return np.array(found, int)

    def depths(self) -> np.ndarray:
        """How many nodes stand above each, shape (M,)."""
        parents = self.parents.tolist()
        depths = [0] * len(parents)
        for node in self.order:
            depths[node] = depths[parents[node]] + 1 if parents[node] >= 0 else 0
        return np.array(depths, int)


@dataclass(frozen=True)
class SkinJoints:
    """The joints of all skins, each node once.

    Args:
        nodes: Node of each joint, length J.
        slots: For each skin, the joint of each of its slots.
        inverse: For each skin, the inverse bind matrix of each slot, shape (slots, 4, 4).
        bind: For each skin, what takes a raw mesh to the pose of the tree through each slot, shape (slots, 4, 4).
        mirrored: Whether each skin turns its meshes inside out.
    """

    nodes: list[int]
    slots: list[np.ndarray]
    inverse: list[np.ndarray]
    bind: list[np.ndarray]
    mirrored: list[bool]


def posed_skins(skins: SkinJoints, tree: NodeTree) -> SkinJoints:
    """The joints with the nodes in another pose."""
    nodes = np.array(skins.nodes, int)
    bind = [tree.world[nodes[slots]] @ inverse for slots, inverse in zip(skins.slots, skins.inverse, strict=True)]
    mirrored = [bool(np.linalg.det(some.mean(axis=0)[:3, :3]) < 0) for some in bind]
    return replace(skins, bind=bind, mirrored=mirrored)


def read_nodes(document: Document) -> NodeTree:
    """World transforms and the default scene of a document.

    A VRM 0.x avatar looks along -Z; it is turned to look along +Z as glTF asks for and as VRM 1.0 does.

    Raises:
        FormatError: The tree has a cycle or a node with two parents, a transform is not finite, or there are too many
            nodes.
    """
    nodes = document.items("nodes")
    if len(nodes) > MAX_NODES:
        document.fail(f"it has {len(nodes):,} nodes but at most {MAX_NODES:,} are read; export the character alone")
    parents = np.full(len(nodes), -1)
    children = [document.indices(node, "children", "nodes") for node in nodes]
    for node, below in enumerate(children):
        for child in below:
            if parents[child] != -1:
                document.fail(f"node {child} has two parents; the file is broken, export it again")
            parents[child] = node
    world, local = np.empty((len(nodes), 4, 4)), _locals(document, nodes)
    order = [int(node) for node in np.flatnonzero(parents < 0)]
    extensions = document.tree.get("extensions")
    turned = isinstance(extensions, dict) and "VRM" in extensions
    front = np.diag([-1.0, 1, -1, 1]) if turned else np.eye(4)
    local[parents < 0] = front @ local[parents < 0]
    for node in order:
        world[node] = world[parents[node]] @ local[node] if parents[node] >= 0 else local[node]
        order.extend(children[node])
    if len(order) != len(nodes):
        document.fail("its nodes form a cycle; the file is broken, export it again")
    if not np.isfinite(world).all():
        document.fail("its node transforms overflow; the file is broken, export it again")
    return NodeTree(parents, world, _scene_nodes(document, parents, children), local)


def _locals(document: Document, nodes: list[dict]) -> np.ndarray:
    """Transform of each node in its parent, shape (M, 4, 4)."""
    parts = {"rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1], "translation": [0.0, 0, 0]}
    values = {key: np.tile(default, (len(nodes), 1)) for key, default in parts.items()}
    given: dict[int, np.ndarray] = {}
    for number, node in enumerate(nodes):
        if "matrix" in node:
            given[number] = document.numbers(node, "matrix", [0.0] * 16).reshape(4, 4).T
            continue
        for key, default in parts.items():
            if key in node:
                values[key][number] = document.numbers(node, key, default)
    local = np.tile(np.eye(4), (len(nodes), 1, 1))
    turned = values["rotation"].any(axis=1)  # a rotation of zeros stands for none
    local[turned, :3, :3] = matrix_from_quaternion(values["rotation"][turned]) * values["scale"][turned, None, :]
    local[:, :3, 3] = values["translation"]
    for number, matrix in given.items():
        local[number, :3] = matrix[:3]
        local[number, 3] = 0, 0, 0, 1
    return local


def _scene_nodes(document: Document, parents: np.ndarray, children: list[list[int]]) -> list[int]:
    scenes = document.items("scenes")
    if scenes:
        stack = list(document.indices(document.item("scenes", document.tree.get("scene", 0)), "nodes", "nodes"))
    else:
        stack = [int(node) for node in np.flatnonzero(parents < 0)]
    seen: set[int] = set()
    while stack:
        node = stack.pop()
        if node not in seen:
            seen.add(node)
            stack.extend(children[node])
    return sorted(seen)


def read_skins(document: Document, tree: NodeTree) -> SkinJoints:
    """Merge the joints of all skins into one list.

    Raises:
        FormatError: A skin has no joints, or fewer inverse bind matrices than joints, or there are too many joints.
    """
    merged: dict[int, int] = {}
    slots, inverses, total = [], [], 0
    for skin in document.items("skins"):
        nodes = document.indices(skin, "joints", "nodes")
        if not nodes:
            document.fail("a skin has no joints; the file is broken, export it again")
        total += len(nodes)
        if total > MAX_SLOTS:
            document.fail(f"its skins have more than {MAX_SLOTS:,} joints; export the character alone")
        slots.append(np.array([merged.setdefault(node, len(merged)) for node in nodes]))
        inverse = np.broadcast_to(np.eye(4), (len(nodes), 4, 4))
        if "inverseBindMatrices" in skin:
            stored = document.accessor(skin["inverseBindMatrices"], ("MAT4",)).astype(float)
            if len(stored) < len(nodes):
                document.fail("a skin has fewer inverse bind matrices than joints; the file is broken, export it again")
            inverse = stored[: len(nodes)].reshape(-1, 4, 4).transpose(0, 2, 1).copy()
            inverse[:, 3] = 0, 0, 0, 1
        if not np.isfinite(inverse).all():
            document.fail("a skin has inverse bind matrices that are not numbers; the file is broken, export it again")
        inverses.append(inverse)
    return posed_skins(SkinJoints(list(merged), slots, inverses, [], []), tree)
