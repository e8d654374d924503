"""The node tree of a glTF document: world transforms, joints, the bind pose, and the nodes at any moment of a clip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bunraku.core.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.core.geometry.rotations import matrix_from_quaternion, quaternion_slerp
from bunraku.files.gltf.document import Document

MAX_NODES = 100_000
MAX_SLOTS = 300_000  # joints of all skins: many skins may name the same ones, and each takes two matrices


@dataclass(frozen=True)
class NodeTree:
    """The nodes of a document in a pose, the default one from `read_nodes`."""

    parents: np.ndarray  # parent of each node, shape (M,); -1 for a root
    world: np.ndarray  # world transform of each node in this pose [m], shape (M, 4, 4)
    scene: list[int]  # nodes of the default scene, ascending
    local: np.ndarray  # transform of each node in its parent as in the file, whatever the pose, shape (M, 4, 4)

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
        """The value chosen for the nearest of the chosen nodes at or above each node, -1 for none, shape (M,)."""
        parents = self.parents.tolist()
        owners = [-1] * len(parents)
        for node in self.order:
            owners[node] = chosen[node] if node in chosen else owners[parents[node]] if parents[node] >= 0 else -1
        return np.array(owners, int)

    def depths(self) -> np.ndarray:
        """How many nodes stand above each, shape (M,)."""
        parents = self.parents.tolist()
        depths = [0] * len(parents)
        for node in self.order:
            depths[node] = depths[parents[node]] + 1 if parents[node] >= 0 else 0
        return np.array(depths, int)


@dataclass(frozen=True)
class SkinJoints:
    """The joints of all skins, each node once."""

    nodes: list[int]  # node of each joint, length J
    slots: list[np.ndarray]  # for each skin, the joint of each of its slots
    inverse: list[np.ndarray]  # for each skin, the inverse bind matrix of each slot, shape (slots, 4, 4)
    # for each skin, the transform of a raw mesh to the pose of the tree through each slot, shape (slots, 4, 4)
    bind: list[np.ndarray]
    mirrored: list[bool]  # whether each skin turns its meshes inside out
    # Joints that move nothing, shape (J,), bool: beside a tree of others, without a joint above or below, and in no
    # clip. Blender writes one for the vertices that have no weights.
    idle: np.ndarray


def posed_skins(skins: SkinJoints, tree: NodeTree) -> SkinJoints:
    """The joints with the nodes in another pose."""
    nodes = np.array(skins.nodes, int)
    bind = [tree.world[nodes[slots]] @ inverse for slots, inverse in zip(skins.slots, skins.inverse, strict=True)]
    mirrored = [bool(np.linalg.det(matrices.mean(axis=0)[:3, :3]) < 0) for matrices in bind]
    return replace(skins, bind=bind, mirrored=mirrored)


def read_nodes(document: Document) -> NodeTree:
    """World transforms and the default scene of a document. A VRM 0.x avatar looks along -Z; it is turned to look along
    +Z, as glTF and VRM 1.0 do. FormatError if the tree has a cycle or a node with two parents, a transform is not
    finite, or there are too many nodes.
    """
    nodes = document.items("nodes")
    if len(nodes) > MAX_NODES:
        document.fail(f"it has {len(nodes):,} nodes but at most {MAX_NODES:,} are read; export the character alone")
    parents = np.full(len(nodes), -1)
    children = [document.indices(node, "children", "nodes") for node in nodes]
    for node, below in enumerate(children):
        for child in below:
            if parents[child] != -1:
                document.broken(f"node {child} has two parents")
            parents[child] = node
    world, local = np.empty((len(nodes), 4, 4)), _locals(document, nodes)
    order = [int(node) for node in np.flatnonzero(parents < 0)]
    local[parents < 0] = front_matrix(document) @ local[parents < 0]
    for node in order:
        world[node] = world[parents[node]] @ local[node] if parents[node] >= 0 else local[node]
        order.extend(children[node])
    if len(order) != len(nodes):
        document.broken("its nodes form a cycle")
    if not np.isfinite(world).all():
        document.broken("its node transforms overflow")
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
    """Merge the joints of all skins into one list. FormatError if a skin has no joints, or fewer inverse bind matrices
    than joints, or there are too many joints.
    """
    merged: dict[int, int] = {}
    slots, inverses, total = [], [], 0
    for skin in document.items("skins"):
        nodes = document.indices(skin, "joints", "nodes")
        if not nodes:
            document.broken("a skin has no joints")
        total += len(nodes)
        if total > MAX_SLOTS:
            document.fail(f"its skins have more than {MAX_SLOTS:,} joints; export the character alone")
        slots.append(np.array([merged.setdefault(node, len(merged)) for node in nodes]))
        inverse = np.broadcast_to(np.eye(4), (len(nodes), 4, 4))
        if "inverseBindMatrices" in skin:
            stored = document.accessor(skin["inverseBindMatrices"], ("MAT4",)).astype(float)
            if len(stored) < len(nodes):
                document.broken("a skin has fewer inverse bind matrices than joints")
            inverse = stored[: len(nodes)].reshape(-1, 4, 4).transpose(0, 2, 1).copy()
            inverse[:, 3] = 0, 0, 0, 1
        if not np.isfinite(inverse).all():
            document.broken("a skin has inverse bind matrices that are not numbers")
        inverses.append(inverse)
    idle = _idle(document, tree, list(merged))
    return posed_skins(SkinJoints(list(merged), slots, inverses, [], [], idle), tree)


def _idle(document: Document, tree: NodeTree, nodes: list[int]) -> np.ndarray:
    """`SkinJoints.idle` of the nodes of all joints."""
    joints, above = tree.nearest({node: joint for joint, node in enumerate(nodes)}), tree.parents[nodes]
    parents = np.where(above >= 0, joints[above], -1)
    moved = [
        channel["target"].get("node")
        for clip in document.items("animations")
        for channel in document.objects(clip, "channels")
        if isinstance(channel.get("target"), dict)
    ]
    played = np.isin(nodes, [node for node in moved if type(node) is int])
    alone = (parents < 0) & ~np.isin(np.arange(len(nodes)), parents) & ~played
    return alone & bool((parents >= 0).any())


SAME_SIZE = 0.03  # bones may differ by this share in length for a placement to be one of the file's own size
MOST_VISITS = 600_000  # of nodes, all of them for each skin that shares no joint with those before
MOST_SPACES = 64  # mesh nodes of one skin that are tried
GROWTH = 3.0  # a bind pose whose joints reach this much farther, or less far, than the default pose's makes no sense


def bind_pose(document: Document, tree: NodeTree, skins: SkinJoints) -> NodeTree:
    """The tree with its joints in the bind pose, or the same tree where the file has none that makes sense."""
    fixed: dict[int, np.ndarray] = {}
    visited = 0
    for skin, meshes in _used_skins(document, tree, skins):
        nodes = [skins.nodes[slot] for slot in skins.slots[skin]]
        inverse = skins.inverse[skin]
        good = [int(i) for i in np.flatnonzero(np.abs(np.linalg.det(inverse)) > 1e-30)]
        if not good:
            return tree
        nodes, inverse = [nodes[i] for i in good], inverse[good]
        bind = np.linalg.inv(inverse)
        bound = [i for i, node in enumerate(nodes) if node in fixed]
        if bound:
            matrix: np.ndarray | None = fixed[nodes[bound[0]]] @ inverse[bound[0]]
        else:
            visited += len(tree.parents)
            if visited > MOST_VISITS:
                return tree
            matrix = _placement(tree, _carried(tree, fixed), nodes, bind, meshes)
        if matrix is None:
            return tree
        for node, world in zip(nodes, matrix @ bind, strict=True):
            fixed.setdefault(node, world)
    if not fixed:
        return tree
    world = _carried(tree, fixed)
    joints = list(fixed)
    before, after = (float(np.ptp(worlds[joints, :3, 3], axis=0).max()) for worlds in (tree.world, world))
    if not np.isfinite(world).all() or not before <= GROWTH * after or not after <= GROWTH * before:
        return tree
    return NodeTree(tree.parents, world, tree.scene, tree.local)


def _used_skins(document: Document, tree: NodeTree, skins: SkinJoints) -> list[tuple[int, list[int]]]:
    """Skins of the scene's meshes, those higher in the tree and with more joints first, and the mesh nodes of each."""
    users: dict[int, list[int]] = {}
    for node in tree.scene:
        entry = document.item("nodes", node)
        skin = entry.get("skin")
        if "mesh" in entry and type(skin) is int and 0 <= skin < len(skins.slots):
            users.setdefault(skin, []).append(node)

    depths = tree.depths()[skins.nodes]

    def rank(skin: int) -> tuple[int, int, int]:
        return int(depths[skins.slots[skin]].min()), -len(skins.slots[skin]), skin

    return [(skin, users[skin]) for skin in sorted(users, key=rank)]


def _carried(tree: NodeTree, fixed: dict[int, np.ndarray]) -> np.ndarray:
    """World transforms where some nodes are fixed and the others follow their parents, shape (M, 4, 4)."""
    if not fixed:
        return tree.world
    world = tree.world.copy()
    for node in tree.order:
        parent = int(tree.parents[node])
        if node in fixed:
            world[node] = fixed[node]
        elif parent >= 0:
            world[node] = world[parent] @ tree.local[node]
    return world


def _placement(
    tree: NodeTree, default: np.ndarray, nodes: list[int], bind: np.ndarray, meshes: list[int]
) -> np.ndarray | None:
    """The transform G from the space of the inverse bind matrices to the world, shape (4, 4), None where nothing fits.

    Exporters differ in that space: it is that of the node above the skeleton, that of the mesh, or the world. Of those
    that give the bones their length in the file, the one that brings the joints closest to the default pose is right,
    rotated by quarter circles where the default pose stands or faces another way. Where none does, the skeleton's root
    is put where it is by default.
    """
    joints: dict[int, int] = {}
    for i, node in enumerate(nodes):
        joints.setdefault(node, i)
    nearest, parents = tree.nearest(joints), tree.parents[nodes]
    root = next((i for i, parent in enumerate(parents) if parent < 0 or nearest[parent] < 0), 0)
    above = int(tree.parents[nodes[root]])
    target = default[nodes]
    pairs = [(i, joints[int(parent)]) for i, parent in enumerate(parents) if int(parent) in joints]

    def distance(choice: np.ndarray) -> float:
        return float(np.sqrt((((choice @ bind)[:, :3, 3] - target[:, :3, 3]) ** 2).sum(axis=1).mean()))

    def fits(choice: np.ndarray) -> bool:
        return bool(abs(np.log(max(_size_ratio(choice @ bind, target, pairs), 1e-9))) <= SAME_SIZE)

    held = target[root] @ np.linalg.inv(bind[root])
    reach = max(float(np.ptp(target[:, :3, 3], axis=0).max()), 1e-12)
    off, size = np.abs((held @ bind - target)[:, :3, :3]).max(), np.abs(target[:, :3, :3]).max()
    if distance(held) <= 1e-3 * reach and off <= 0.02 * size:
        return held  # the nodes stand in the bind pose
    spaces = [default[above] if above >= 0 else np.eye(4), *(default[mesh] for mesh in meshes[:MOST_SPACES]), np.eye(4)]
    spaces = [space for space in spaces if fits(space)]
    if not spaces:
        return held if fits(held) else None
    best = min(spaces, key=lambda space: round(distance(space), 9))
    return _facing(best, best @ bind, target, root)


SUNK = 0.25
"""A body whose lowest joint is so far from where viewers draw it, over its height, stands elsewhere. Chosen by eye."""


def _facing(placement: np.ndarray, placed: np.ndarray, target: np.ndarray, root: int) -> np.ndarray:
    """The placement rotated by quarter circles about its root joint, to stand up and face as the default pose does,
    which is what viewers draw, shape (4, 4), and moved up or down where its root alone is elsewhere by far. The mean
    rotation of all joints decides: clips rotate single limbs any way, but all joints one way only with the whole body.
    """
    ours, want = (
        points[:, :3, :3] / np.cbrt(np.abs(np.linalg.det(points[:, :3, :3])) + 1e-30)[:, None, None]
        for points in (placed, target)
    )
    change = np.einsum("jab,jcb->ac", want, ours)
    turn, ways = np.eye(4), (upright_rotation(*axes) for axes in ORIENTATIONS)
    turn[:3, :3] = max(ways, key=lambda way: float((way * change).sum()))
    turn[:3, 3] = placed[root, :3, 3] - turn[:3, :3] @ placed[root, :3, 3]
    heights, wanted = ((turn @ placed)[:, 1, 3], target[:, 1, 3])
    below, shift = wanted.min() - heights.min(), wanted[root] - heights[root]
    if abs(below) > SUNK * max(float(np.ptp(heights)), float(np.ptp(wanted))) and abs(below - shift) < 0.5 * abs(below):
        turn[1, 3] += shift
    return turn @ placement


def _size_ratio(placed: np.ndarray, target: np.ndarray, pairs: list[tuple[int, int]]) -> float:
    """How much longer bones are than they should be, the median; for single joints how much larger their axes are."""
    child, parent = np.array([i for i, _ in pairs], int), np.array([j for _, j in pairs], int)
    lengths = np.linalg.norm(placed[child, :3, 3] - placed[parent, :3, 3], axis=1)
    want = np.linalg.norm(target[child, :3, 3] - target[parent, :3, 3], axis=1)
    clear = (lengths > 1e-3 * lengths.max(initial=0)) & (want > 1e-3 * want.max(initial=0))
    if not clear.any():
        volumes = [abs(np.linalg.det(matrices[:, :3, :3])).mean() for matrices in (placed, target)]
        return float(np.cbrt(volumes[0] / max(volumes[1], 1e-30)))
    return float(np.median(lengths[clear] / want[clear]))


MAX_SECONDS = 600.0
"""Longest clip that is played [s]."""

MAX_KEYS = 50_000_000  # of all channels of a clip: channels may share their keys, and take memory each
MAX_WORLDS = 20_000_000  # transforms of all nodes that joints hang on, in all frames: 2.6 GB

Curves = dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]

_DEFAULTS = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}


def clip_curves(document: Document, animation: dict[str, object]) -> Curves:
    """Times (M,), values (M, C) or (M, 3, C), and interpolation of each animated (node, property)."""
    samplers = document.objects(animation, "samplers")
    curves, total, last = {}, 0, max(len(document.items("nodes")) - 1, 0)
    for channel in document.objects(animation, "channels"):
        target = channel.get("target")
        if not isinstance(target, dict) or target.get("path") not in tuple(_DEFAULTS) or "node" not in target:
            continue  # morph targets and what extensions add
        node, kind = document.integer(target, "node", high=last), target["path"]
        index = document.integer(channel, "sampler")
        if index >= len(samplers):
            document.broken("an animation channel names a sampler that does not exist")
        how = samplers[index].get("interpolation", "LINEAR")
        times = document.accessor(samplers[index].get("input"), ("SCALAR",))[:, 0].astype(float)
        kinds = ("VEC4",) if kind == "rotation" else ("VEC3",)
        values = document.accessor(samplers[index].get("output"), kinds).astype(float)
        keys = 3 if how == "CUBICSPLINE" else 1
        total += len(values)
        if total > MAX_KEYS:
            document.fail(f"its clip has more than {MAX_KEYS:,} keys; cut it")
        fitting = len(times) > 0 and len(values) == keys * len(times) and bool((np.diff(times) > 0).all())
        if not fitting or not np.isfinite(values).all() or not np.isfinite(times).all():
            document.broken("an animation channel has keys that do not fit together")
        curves[node, kind] = (times, values.reshape(len(times), 3, -1) if keys == 3 else values, str(how))
    return curves


def _sample(times: np.ndarray, values: np.ndarray, how: str, kind: str, moments: np.ndarray) -> np.ndarray:
    """Values of a curve at moments [s], held before the first key and after the last, shape (N, C)."""
    before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    step = times[after] - times[before]
    share = np.clip((moments - times[before]) / np.where(step > 0, step, 1), 0, 1)
    if how == "STEP":
        return values[before]
    if how == "CUBICSPLINE":
        s, d = share[:, None], step[:, None]
        start, end = values[before], values[after]  # each key: in-tangent, value, out-tangent
        out = (2 * s**3 - 3 * s**2 + 1) * start[:, 1] + d * (s**3 - 2 * s**2 + s) * start[:, 2]
        return out + (3 * s**2 - 2 * s**3) * end[:, 1] + d * (s**3 - s**2) * end[:, 0]
    if kind == "rotation":
        return quaternion_slerp(values[before], values[after], share)
    return values[before] + (values[after] - values[before]) * share[:, None]


def node_worlds(
    document: Document, tree: NodeTree, curves: Curves, moments: np.ndarray, chosen: list[int]
) -> np.ndarray:
    """World transforms of the chosen nodes at each moment, shape (N, J, 4, 4)."""
    nodes = document.items("nodes")
    moving = {node for node, _ in curves}
    worlds: dict[int, np.ndarray] = {}

    def world(node: int) -> np.ndarray:
        chain = []
        while node >= 0 and node not in worlds:
            chain.append(node)
            node = int(tree.parents[node])
        if (len(worlds) + len(chain)) * len(moments) > MAX_WORLDS:
            size = f"{len(worlds) + len(chain)} nodes in {len(moments)} frames"
            document.fail(f"its clip moves {size}, which are too many; cut it")
        for link in reversed(chain):
            above = int(tree.parents[link])
            if link not in moving:  # its default place, carried along by what is above it
                rest = tree.local[link]
                worlds[link] = worlds[above] @ rest if above >= 0 else np.broadcast_to(rest, (len(moments), 4, 4))
            else:
                local = _local(document, nodes[link], link, curves, moments)
                worlds[link] = worlds[above] @ local if above >= 0 else front_matrix(document) @ local
        return worlds[chain[0]] if chain else worlds[node]

    return np.stack([world(node) for node in chosen], axis=1)


def front_matrix(document: Document) -> np.ndarray:
    """The rotation that `read_nodes` gives a VRM 0.x avatar, else the identity."""
    return np.diag([-1.0, 1, -1, 1]) if "VRM" in document.extensions else np.eye(4)


def _local(document: Document, node: dict[str, object], index: int, curves: Curves, moments: np.ndarray) -> np.ndarray:
    parts = {}
    for kind, default in _DEFAULTS.items():
        if (index, kind) in curves:
            times, values, how = curves[index, kind]
            parts[kind] = _sample(times, values, how, kind, moments)
        else:
            parts[kind] = np.broadcast_to(document.numbers(node, kind, default), (len(moments), len(default)))
    local = np.zeros((len(moments), 4, 4))
    local[:, :3, :3] = matrix_from_quaternion(parts["rotation"]) * parts["scale"][:, None, :]
    local[:, :3, 3], local[:, 3, 3] = parts["translation"], 1
    return local
