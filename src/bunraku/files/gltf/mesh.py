"""Meshes of a glTF document in its default pose: positions, triangles and repaired skin weights, in world space."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bunraku.core.geometry.graph import mesh_parts
from bunraku.files.gltf.document import Document
from bunraku.files.gltf.nodes import NodeTree, SkinJoints


def strongest(
    points: np.ndarray, joints: np.ndarray, shares: np.ndarray, count: int, influences: int
) -> tuple[np.ndarray, np.ndarray]:
    """The largest shares of each of `count` vertices, V, as a table, renormalised: of the vertex, joint and share (not
    negative) of each influence, shape (S,), at most `influences` joints of a vertex.

    Returns:
        Joints (V, M) and shares (V, M), largest first; rows sum to 1, or to 0 where a vertex has none.
    """
    order = np.lexsort((joints, -shares, points))
    points, joints, shares = points[order], joints[order], shares[order]
    rank = np.arange(len(points)) - np.searchsorted(points, np.arange(count))[points] if len(points) else points
    kept = (rank < influences) & (shares > 0)
    width = int(rank[kept].max(initial=0)) + 1
    indices, weights = np.zeros((count, width), np.int64), np.zeros((count, width))
    indices[points[kept], rank[kept]], weights[points[kept], rank[kept]] = joints[kept], shares[kept]
    total = weights.sum(axis=1, keepdims=True)
    return indices, weights / np.where(total > 0, total, 1)


MAX_VERTICES, MAX_TRIANGLES, MAX_PRIMITIVES = 20_000_000, 40_000_000, 20_000
MAX_WORK = 150_000_000
"""Most vertices over all primitives, each counted as often as it is used: for its morph targets, and for colours."""

_VERTEX, _INFLUENCE, _TRIANGLE = 72, 32, 40
"""About how many bytes a vertex, one of its influences, and a triangle take while a character is read."""


@dataclass(frozen=True)
class PrimitiveData:
    """The vertices that one or several primitives of a mesh share."""

    primitives: tuple[int, ...]  # indices of the primitives in their mesh
    vertices: np.ndarray  # default-pose positions in world space [m], shape (V, 3), float64
    triangles: tuple[np.ndarray, ...]  # for each primitive, vertex indices, shape (F, 3), int32
    joints: np.ndarray  # joints of the merged list, shape (V, M)
    weights: np.ndarray  # their shares, rows sum to 1, shape (V, M); empty where there is no rig


@dataclass(frozen=True)
class MeshPart:
    """A mesh where a node places it."""

    # node, mesh: the node and its mesh
    node: int
    mesh: int
    # from raw positions to the rest pose, shape (4, 4), or None where the skin bends the mesh in its rest pose
    transform: np.ndarray | None
    mirrored: bool  # whether the transform turns the triangles inside out; those of the groups are turned back
    groups: tuple[PrimitiveData, ...]  # its vertices

    def split(self, rows: np.ndarray) -> Iterator[tuple[PrimitiveData, np.ndarray]]:
        """The groups, each with its own of some rows over all of them."""
        start = 0
        for group in self.groups:
            yield group, rows[start : start + len(group.vertices)]
            start += len(group.vertices)


def primitive_groups(document: Document, mesh: int) -> Iterator[tuple[tuple[int, ...], dict[str, Any]]]:
    """Primitives of a mesh that share their positions and skin, with the attributes that they share."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    primitives = document.objects(document.item("meshes", mesh), "primitives")
    for index, primitive in enumerate(primitives):
        attributes = primitive.get("attributes")
        if not isinstance(attributes, dict):
            document.broken(f"meshes[{mesh}] has a primitive without attributes")
        if "POSITION" not in attributes:
            continue  # glTF lets extensions bring positions; there is nothing to draw without one
        groups.setdefault(_shared(attributes, primitive.get("targets")), []).append(index)
    for members in groups.values():
        yield tuple(members), primitives[members[0]]["attributes"]


def _shared(attributes: dict[str, object], targets: object) -> tuple[str, ...]:
    """What primitives of a mesh that share their vertices have in common."""
    names = ("POSITION", "JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1")
    return *map(repr, map(attributes.get, names)), repr(targets)


def primitive_triangles(document: Document, primitive: dict[str, object], count: int) -> np.ndarray:
    """Vertex indices of a primitive's triangles: lists, strips and fans; none for points and lines, shape (F, 3)."""
    mode = document.integer(primitive, "mode", 4, high=6)
    if mode < 4:
        return np.zeros((0, 3), np.int32)
    if "indices" in primitive:
        order = document.accessor(primitive["indices"], ("SCALAR",), raw=True)[:, 0]
        if order.dtype.kind != "u":
            document.broken("the indices of a mesh are not unsigned whole numbers")
        if len(order) and int(order.max()) >= count:
            document.broken(f"a triangle uses vertex {int(order.max())} but its mesh has {count}")
        order = order.astype(np.int32)
    else:
        order = np.arange(count, dtype=np.int32)
    if mode == 4:
        return order[: len(order) - len(order) % 3].reshape(-1, 3)
    if len(order) < 3:
        return np.zeros((0, 3), np.int32)
    if mode == 6:
        return np.stack([order[1:-1], order[2:], np.full(len(order) - 2, order[0], np.int32)], axis=1)
    strip = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    strip[1::2, 1:] = strip[1::2, 2:0:-1]
    return strip


def read_part(document: Document, tree: NodeTree, skins: SkinJoints, node: int, carrier: int) -> MeshPart:
    """The mesh of a node in world space, in the default pose of its node or of its skin; `carrier` is the joint that
    carries it where it has no skin (`rigid_joints`). FormatError if an index, a count or a type is wrong.
    """
    entry = document.item("nodes", node)
    mesh = document.integer(entry, "mesh")
    document.item("meshes", mesh)
    skin = document.integer(entry, "skin") if "skin" in entry else None
    if skin is not None and skin >= len(skins.slots):
        document.broken(f"node {node} uses a skin that does not exist")
    mirrored = bool(np.linalg.det(tree.world[node, :3, :3]) < 0) if skin is None else skins.mirrored[skin]
    primitives = document.item("meshes", mesh)["primitives"]
    rows = [
        (members, attributes, rest_positions(document, entry, mesh, primitives[members[0]]))
        for members, attributes in primitive_groups(document, mesh)
    ]
    held = [_influences(document, attributes, raw, skins, skin) for _, attributes, raw in rows]
    faces = [
        [primitive_triangles(document, primitives[member], len(raw))[:, [0, 2, 1] if mirrored else [0, 1, 2]]
         for member in members]
        for members, _, raw in rows
    ]  # fmt: skip
    if skin is not None:
        _borrow(
            [raw for _, _, raw in rows], [np.concatenate(some) for some in faces], held, skins.idle[skins.slots[skin]]
        )
    groups: list[PrimitiveData] = []
    transforms: list[np.ndarray | None] = []
    for (members, _, raw), corners, influences in zip(rows, faces, held, strict=True):
        triangles = tuple(map(np.ascontiguousarray, corners))
        if skin is not None and influences is not None:
            slots, shares = influences
            weights = shares / shares.sum(axis=1, keepdims=True)
            vertices, transform = _skinned(raw, slots, weights, skins.bind[skin])
            joints = skins.slots[skin][slots]
        else:
            transform = tree.world[node]
            vertices = raw @ transform[:3, :3].T + transform[:3, 3]
            joints = np.broadcast_to(np.int64(carrier), (len(raw), 1))
            weights = np.broadcast_to(np.float64(1), (len(raw), 1))
        groups.append(PrimitiveData(members, vertices, triangles, joints, weights))
        transforms.append(transform)
    return MeshPart(node, mesh, _common(transforms), mirrored, tuple(groups))


def skin_matrices(document: Document, tree: NodeTree, skins: SkinJoints, part: MeshPart, group: int) -> np.ndarray:
    """Transform of each raw vertex of a group to its rest position, shape (V, 4, 4)."""
    entry, data = document.item("nodes", part.node), part.groups[group]
    attributes = document.item("meshes", part.mesh)["primitives"][data.primitives[0]]["attributes"]
    if "skin" in entry and "JOINTS_0" in attributes and "WEIGHTS_0" in attributes:
        slots, slot = skins.slots[entry["skin"]], np.zeros(len(skins.nodes), int)
        slot[slots[::-1]] = np.arange(len(slots))[::-1]
        return np.einsum("vm,vmij->vij", data.weights, skins.bind[entry["skin"]][slot[data.joints]])
    return np.broadcast_to(tree.world[part.node], (len(data.vertices), 4, 4))


def rest_positions(document: Document, node: dict[str, object], mesh: int, primitive: dict[str, object]) -> np.ndarray:
    """Raw positions of a primitive with the default weights of its morph targets applied, shape (V, 3), float64."""
    raw = document.accessor(document.entry(primitive, "attributes")["POSITION"], ("VEC3",)).astype(float)
    entry = document.item("meshes", mesh)
    weights = node.get("weights", entry.get("weights", []))
    targets = document.objects(primitive, "targets")
    if isinstance(weights, list) and all(type(weight) in (int, float) for weight in weights):
        for weight, target in zip(weights, targets, strict=False):
            if (
                weight
                and np.isfinite(weight)
                and "POSITION" in target
                and document.count(target["POSITION"]) == len(raw)
            ):
                raw += weight * document.accessor(target["POSITION"], ("VEC3",))
    return raw


def check_size(document: Document, nodes: list[int]) -> None:
    """Raise FormatError where the nodes of a document place too many vertices, triangles or primitives; many may place
    one mesh, so the file's size does not bound it.
    """
    sizes: dict[Any, np.ndarray] = {}
    total = np.zeros(5, dtype=object)
    for node in nodes:
        placed = document.item("nodes", node)
        if placed.get("mesh") is None:
            continue
        entry = document.item("meshes", placed["mesh"])
        weights = placed.get("weights", entry.get("weights"))
        key = placed["mesh"], len(weights) if isinstance(weights, list) else 0
        if key not in sizes:
            sizes[key] = _sizes(document, entry, key[1])
        total += sizes[key]
    vertices, corners, primitives, influences, work = total
    if vertices > MAX_VERTICES or corners > 3 * MAX_TRIANGLES or primitives > MAX_PRIMITIVES:
        limits = f"{MAX_VERTICES:,} vertices, {MAX_TRIANGLES:,} triangles or {MAX_PRIMITIVES:,} pieces"
        document.fail(f"it has more than {limits}; simplify the mesh first")
    if work > MAX_WORK:
        document.fail(f"its morph targets go over {work:,} vertices, at most {MAX_WORK:,} are read; drop some")
    document.check_memory(_VERTEX * vertices + _INFLUENCE * influences + _TRIANGLE * corners // 3)


def _sizes(document: Document, mesh: dict[str, object], weighted: int) -> np.ndarray:
    """Vertices, corners, primitives and influences of a mesh with this many weights of morph targets, and vertices
    counted as often as they are used.
    """
    vertices = corners = influences = work = 0
    primitives = document.objects(mesh, "primitives")
    seen: set[tuple[str, ...]] = set()
    for primitive in primitives:
        attributes = primitive.get("attributes")
        if not isinstance(attributes, dict) or "POSITION" not in attributes:
            continue
        count = document.count(attributes["POSITION"])
        shared = _shared(attributes, primitive.get("targets"))
        if shared not in seen:
            vertices += count
            influences += count * 4 * sum(name in attributes for name in ("JOINTS_0", "JOINTS_1"))
            work += count * min(weighted, len(document.objects(primitive, "targets")))
        seen.add(shared)
        work += count
        corners += document.count(primitive["indices"]) if "indices" in primitive else count
    return np.array([vertices, corners, len(primitives), influences, work], dtype=object)


def rigid_joints(tree: NodeTree, skins: SkinJoints) -> np.ndarray:
    """The joint that carries each node's mesh without a skin, shape (M,): the nearest one at or above it, else the
    first joint without a joint above; 0 where there are no joints.
    """
    if not skins.nodes:
        return np.zeros(len(tree.parents), int)
    joints = tree.nearest({node: joint for joint, node in enumerate(skins.nodes)})
    above = tree.parents[skins.nodes]
    free = np.flatnonzero((above < 0) | (joints[above] < 0))
    return np.where(joints >= 0, joints, int(free[0]) if len(free) else 0)


def _influences(
    document: Document, attributes: dict[str, object], raw: np.ndarray, skins: SkinJoints, skin: int | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Slots of each vertex and their shares, 0 where they are broken, shape (V, M); None where there is no skin."""
    if skin is None or "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes:
        return None
    joints, weights = [], []
    for name in ("0", "1"):
        if f"JOINTS_{name}" in attributes and f"WEIGHTS_{name}" in attributes:
            joints.append(document.accessor(attributes[f"JOINTS_{name}"], ("VEC4",), raw=True))
            weights.append(document.accessor(attributes[f"WEIGHTS_{name}"], ("VEC4",)).astype(float))
            if len(joints[-1]) != len(raw) or len(weights[-1]) != len(raw) or joints[-1].dtype.kind != "u":
                document.broken("the skin of a mesh weighs another number of vertices than it has")
    indices, shares = np.concatenate(joints, 1).astype(np.int64), np.concatenate(weights, 1)
    shares = np.where(np.isfinite(shares) & (shares > 0), shares, 0)
    indices[shares == 0] = 0
    slots = len(skins.slots[skin])
    if len(indices) and int(indices.max()) >= slots:
        document.broken(f"a vertex is weighted to joint {int(indices.max())} of a skin with {slots}")
    return indices, shares


def _borrow(
    raws: list[np.ndarray], triangles: list[np.ndarray], held: list[tuple[np.ndarray, np.ndarray] | None],
    idle: np.ndarray,
) -> None:  # fmt: skip
    """Give the vertices of a mesh that no joint moves the weights of the nearest ones that some do, in place. A loose
    piece of them moves as a whole with the joint that is nearest to most of it; one that lies apart, as the barrel of
    a gun, is asked last, when what it hangs on is known.

    Args:
        raws: Positions of each primitive, shape (V, 3).
        triangles: Of each, shape (F, 3).
        held: Slots and shares of each (`_influences`); rows of shares sum to more than 0 afterwards.
        idle: Slots of joints that move nothing (`SkinJoints.idle`), shape (slots,), bool.
    """
    pairs = {number: pair for number, pair in enumerate(held) if pair is not None}
    if not any(((pair[1] * ~idle[pair[0]]).sum(axis=1) <= 1e-9).any() for pair in pairs.values()):
        return
    from scipy.spatial import cKDTree

    starts = np.cumsum([0, *(len(raws[number]) for number in pairs)])
    width = max(pair[0].shape[1] for pair in pairs.values())
    slots, shares = (
        np.concatenate([np.pad(pair[part], ((0, 0), (0, width - pair[part].shape[1]))) for pair in pairs.values()])
        for part in (0, 1)
    )
    held_by_some = (shares * ~idle[slots]).sum(axis=1) > 1e-9
    lost, good = np.flatnonzero(~held_by_some), np.flatnonzero(held_by_some)
    if not len(good):
        lost, good, slots[0], shares[0] = lost[1:], lost[:1], 0, np.eye(1, width)
    points = np.nan_to_num(np.concatenate([raws[number] for number in pairs]))
    corners = np.concatenate([triangles[number] + start for number, start in zip(pairs, starts, strict=False)])
    index = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    piece = mesh_parts(np.concatenate([index[corners[:, :2]], index[corners[:, 1:]]]), int(index.max()) + 1)[index]
    piece[lost] = np.where(np.isin(piece[lost], piece[good]), len(points) + lost, piece[lost])  # each for itself
    for again in (False, True):
        if not len(lost):
            break
        gap, near = cKDTree(points[good]).query(points[lost])
        _, own, size = np.unique(piece[lost], return_inverse=True, return_counts=True)
        least, most = np.full(len(size), np.inf), np.zeros(len(size))
        np.minimum.at(least, own, gap)
        np.maximum.at(most, own, gap)
        beside = (size == 1) | (2 * least <= most) | again
        joint = slots[good[near], shares[good[near]].argmax(axis=1)]
        _, vote, many = np.unique(own * len(idle) + joint, return_inverse=True, return_counts=True)
        order = np.lexsort((gap, -many[vote], own))  # the nearest of the joint that most of a piece is near to
        speaks = near[order][np.searchsorted(own[order], np.arange(len(size)))][own]
        told = beside[own]
        slots[lost[told]], shares[lost[told]] = slots[good[speaks[told]]], shares[good[speaks[told]]]
        good, lost = np.concatenate([good, lost[told]]), lost[~told]
    for number, own, share in zip(pairs, np.split(slots, starts[1:-1]), np.split(shares, starts[1:-1]), strict=True):
        held[number] = own, share


def _skinned(
    raw: np.ndarray, slots: np.ndarray, weights: np.ndarray, bind: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Default-pose positions of a skinned mesh, and the one matrix that gives them where one does."""
    used = np.unique(slots[weights > 0])
    mean = bind[used].mean(axis=0) if len(used) else np.eye(4)
    finite = np.isfinite(raw).all(axis=1)
    reach = np.abs(raw[finite]).max(axis=0, initial=0)
    extent = float(np.ptp(raw[finite], axis=0).max()) if finite.any() else 0.0
    tolerance = 1e-5 * max(extent, 1e-12) * max(float(np.abs(mean[:3, :3]).max()), 1e-12)
    spread = np.abs(bind[used] - mean)
    if (spread[:, :3, :3] @ reach + spread[:, :3, 3:].reshape(-1, 3)).max(initial=0) <= tolerance:
        return raw @ mean[:3, :3].T + mean[:3, 3], mean
    vertices = np.zeros_like(raw)
    for column in range(slots.shape[1]):
        if weights[:, column].any():
            matrices = bind[slots[:, column]]
            vertices += weights[:, column, None] * (
                np.einsum("vij,vj->vi", matrices[:, :3, :3], raw) + matrices[:, :3, 3]
            )
    if not finite.all() or not np.isfinite(vertices).all():
        return vertices, None
    fit, _, rank, _ = np.linalg.lstsq(np.c_[raw, np.ones(len(raw))], vertices, rcond=1e-7)
    affine = raw @ fit[:3] + fit[3]
    if rank < 4 or float(np.abs(vertices - affine).max(initial=0)) > tolerance:
        return vertices, None
    transform = np.eye(4)
    transform[:3] = fit.T
    return affine, transform


def _common(transforms: list[np.ndarray | None]) -> np.ndarray | None:
    """The matrix that all groups of a mesh share, None where they differ: a node has one skin."""
    first = transforms[0] if transforms else None
    if first is None or any(
        other is None or not np.allclose(other, first, rtol=1e-6, atol=1e-9) for other in transforms
    ):
        return None
    return first
