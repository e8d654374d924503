"""The bind pose of a glTF document: the pose in which its meshes were skinned, whatever the nodes say.

Game packs often leave their nodes in the middle of a clip. The inverse bind matrices still tell the pose of modelling:
joint j stood at `inverse(IBM_j)`, up to one transform G that all joints of a skin share. G is what the file itself says
of where the skeleton stands; what hangs on a joint without being skinned (a weapon, a hat) goes along with its joint.
"""

from __future__ import annotations

import numpy as np

from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.scene.nodes import NodeTree, SkinJoints
from bunraku.geometry.rotations import matrix_y

__all__ = ["bind_pose"]

SAME_SIZE = 0.03  # bones may differ by this share in length for a placement to be one of the file's own size
MOST_VISITS = 600_000  # of nodes, all of them for each skin that shares no joint with those before
MOST_SPACES = 64  # mesh nodes of one skin that are tried
GROWTH = 3.0  # a bind pose whose joints reach this much farther, or less far, than the default pose's makes no sense


def bind_pose(document: Document, tree: NodeTree, skins: SkinJoints) -> NodeTree:
    """The tree with its joints in the bind pose, or the same tree where the file has none that makes sense.

    Args:
        document: The document.
        tree: Its nodes in their default pose.
        skins: Its joints.
    """
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
        known = [i for i, node in enumerate(nodes) if node in fixed]
        if known:
            matrix: np.ndarray | None = fixed[nodes[known[0]]] @ inverse[known[0]]
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
    before, after = (float(np.ptp(some[joints, :3, 3], axis=0).max()) for some in (tree.world, world))
    if not np.isfinite(world).all() or not before <= GROWTH * after or not after <= GROWTH * before:
        return tree
    return NodeTree(tree.parents, world, tree.scene, tree.local)


def _used_skins(document: Document, tree: NodeTree, skins: SkinJoints) -> list[tuple[int, list[int]]]:
    """Skins that the scene's meshes use, those higher in the tree and with more joints first, and the mesh nodes of
    each.
    """
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
    that give the bones the length that they have in the file, the one that brings the joints closest to the default
    pose is right, turned by a quarter or a half about +Y where only the clip turned the skeleton to the front. Where
    none does, the skeleton's root is put where it is by default.
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
    if distance(held) <= 1e-3 * reach and np.allclose(
        (held @ bind)[:, :3, :3], target[:, :3, :3], rtol=0, atol=0.02 * np.abs(target[:, :3, :3]).max()
    ):
        return held  # the nodes stand in the bind pose
    spaces = [default[above] if above >= 0 else np.eye(4), *(default[mesh] for mesh in meshes[:MOST_SPACES]), np.eye(4)]
    spaces = [space for space in spaces if fits(space)]
    if not spaces:
        return held if fits(held) else None
    best = min(spaces, key=lambda space: round(distance(space), 9))
    return _facing(best, best @ bind, target, root)


def _facing(placement: np.ndarray, placed: np.ndarray, target: np.ndarray, root: int) -> np.ndarray:
    """The placement turned by quarters about the vertical through its root joint, to face where the default pose does,
    shape (4, 4).

    The mean turn of all joints tells: clips turn single limbs any way, but all joints one way only where they turn the
    whole.
    """
    own, want = (
        some[:, :3, :3] / np.cbrt(np.abs(np.linalg.det(some[:, :3, :3])) + 1e-30)[:, None, None]
        for some in (placed, target)
    )
    change = np.einsum("jab,jcb->ac", want, own)
    yaw = np.arctan2(change[0, 2] - change[2, 0], change[0, 0] + change[2, 2])
    quarters = np.round(yaw / (np.pi / 2))
    turn = np.eye(4)
    turn[:3, :3] = np.round(matrix_y(np.array(quarters * np.pi / 2)))
    turn[:3, 3] = placed[root, :3, 3] - turn[:3, :3] @ placed[root, :3, 3]
    return turn @ placement


def _size_ratio(placed: np.ndarray, target: np.ndarray, pairs: list[tuple[int, int]]) -> float:
    """How much longer the bones are than they should be, the median; of single joints how much larger their axes
    are.
    """
    child, parent = np.array([i for i, _ in pairs], int), np.array([j for _, j in pairs], int)
    own = np.linalg.norm(placed[child, :3, 3] - placed[parent, :3, 3], axis=1)
    want = np.linalg.norm(target[child, :3, 3] - target[parent, :3, 3], axis=1)
    clear = (own > 1e-3 * own.max(initial=0)) & (want > 1e-3 * want.max(initial=0))
    if not clear.any():
        volumes = [abs(np.linalg.det(some[:, :3, :3])).mean() for some in (placed, target)]
        return float(np.cbrt(volumes[0] / max(volumes[1], 1e-30)))
    return float(np.median(own[clear] / want[clear]))
