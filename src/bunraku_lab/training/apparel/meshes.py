"""Characters of the wardrobe as points of their surface, with their true weights and distances to the joints: what the
body network learns from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from bunraku.apparel.nodes import part_neighbours
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.character import Character
from bunraku.core.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_normals
from bunraku_lab.datasets.apparel.plan import character_split
from bunraku_lab.training.rows.banks import kept_arrays

POINTS = 1024
TOUCH = 0.03
"""How near vertices of loose parts are that lie on one another, over the height; the body network was trained with it.
"""
REACH = 5.0
"""How far from a joint it begins to be the surface, over the distance of the nearest vertex."""
_SIDES = np.array([side for side in np.ndindex(3, 3, 3) if side != (1, 1, 1)], np.float64) - 1
_SIDES /= np.linalg.norm(_SIDES, axis=1, keepdims=True)

_MESH = ("clean", "points", "joints", "normals", "part", "neighbours")


@dataclass(frozen=True, eq=False)
class SampledMesh:
    """S points of a mesh."""

    clean: np.ndarray  # clean vertex (`geometry.graph.clean_mesh`) that each is, shape (S,)
    points: np.ndarray  # in units of the height, feet at 0, x and z from the pelvis, shape (S, 3), float32
    joints: np.ndarray  # J in the same units, shape (22, 3)
    normals: np.ndarray  # shape (S, 3), float32
    part: np.ndarray  # loose part of the mesh of each, shape (S,)
    neighbours: np.ndarray  # nearest points of the same part, shape (S, NEIGHBOURS)
    index: np.ndarray  # clean vertex of each vertex of the mesh, shape (V,)
    # nearest, shares: the nearest points of the same part to each vertex, shape (V, 3), and their weights, rows sum to
    # 1
    nearest: np.ndarray
    shares: np.ndarray

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Values of the points at all vertices of the mesh, shape (S, C) -> (V, C)."""
        return np.asarray((values[self.nearest] * self.shares[..., None]).sum(axis=1))


def sampled_mesh(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, most: int = POINTS, seed: int = 0
) -> SampledMesh:
    """At most so many points of a rest mesh [m], +Y up, facing +Z, with joints J (22, 3): some of every loose part,
    more of larger ones. `seed` decides the choice.

    Raises:
        CharacterError: The mesh is broken.
    """
    clean = clean_mesh(vertices, faces)
    count = len(clean.vertices)
    edges = unique_edges(clean.faces, count)
    part = mesh_parts(edges, count)
    chosen = _chosen(part, min(most, count), np.random.default_rng(seed))
    positions = clean.vertices * clean.scale + clean.center
    low, height = positions[:, 1].min(), max(float(np.ptp(positions[:, 1])), 1e-9)
    origin = np.array([joints[0, 0], low, joints[0, 2]])
    points = (positions[chosen] - origin) / height
    bones = (np.asarray(joints, np.float64) - origin) / height
    normals = vertex_normals(clean.vertices, clean.faces)[chosen].astype(np.float32)
    nearest, shares = _near(positions, part, chosen)
    return SampledMesh(
        chosen, points.astype(np.float32), bones.astype(np.float32), normals, part[chosen],
        part_neighbours(positions[chosen], part[chosen]), clean.index, nearest[clean.index], shares[clean.index],
    )  # fmt: skip


def _chosen(part: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """At least three vertices of every part, as far as there is room; the rest by the share of vertices."""
    order = rng.permutation(len(part))
    rank = np.empty(len(part), np.int64)
    by_part = order[np.argsort(part[order], kind="stable")]
    starts = np.searchsorted(part[by_part], part[by_part])
    rank[by_part] = np.arange(len(part)) - starts
    priority = np.where(rank < 3, rank - 3.0, rng.random(len(part)))
    return np.sort(np.argsort(priority, kind="stable")[:most])


def _near(positions: np.ndarray, part: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The three nearest points of each clean vertex (C, 3), and their shares."""
    nearest, shares = np.zeros((len(positions), 3), np.int64), np.zeros((len(positions), 3))
    own_part = part[chosen]
    far = cKDTree(positions[chosen])
    for number in range(int(part.max()) + 1):
        rows, points_of_part = np.flatnonzero(part == number), np.flatnonzero(own_part == number)
        if not len(points_of_part):  # more parts than points: those without one take the nearest of any
            gap, found = far.query(positions[rows], 3 if len(chosen) >= 3 else 1)
            points_of_part = np.arange(len(chosen))
        else:
            gap, found = cKDTree(positions[chosen[points_of_part]]).query(positions[rows], min(3, len(points_of_part)))
        gap, found = gap.reshape(len(rows), -1), found.reshape(len(rows), -1)
        weight = 1 / (gap + 1e-6)
        nearest[rows, : found.shape[1]] = points_of_part[found]
        shares[rows, : found.shape[1]] = weight / weight.sum(axis=1, keepdims=True)
    return nearest, shares


@dataclass(frozen=True, eq=False)
class MeshSample:
    """A character of the wardrobe.

    Args:
        name: Its name.
        mesh: Its points.
        apparel: Which are apparel, shape (S,), bool.
        weights: True skinning weights, shape (S, 22).
        geodesics: G, shape (S, 22).
    """

    name: str
    mesh: SampledMesh
    apparel: np.ndarray
    weights: np.ndarray
    geodesics: np.ndarray


def mesh_sample(character: Character, name: str, seed: int = 0) -> MeshSample:
    """Sample a character whose file has physics.

    Raises:
        BunrakuError: It cannot be used.
    """
    clothed = clothed_from_file(character)
    mesh = sampled_mesh(clothed.rest, clothed.faces, clothed.joints, seed=seed)
    first = np.zeros(mesh.index.max() + 1, np.int64)
    first[mesh.index] = np.arange(len(mesh.index))
    cloth = np.zeros(len(first), bool)
    cloth[mesh.index[clothed.apparel]] = True
    return MeshSample(
        name, mesh, cloth[mesh.clean], clothed.weights[first[mesh.clean]].astype(np.float32),
        joint_distances(clothed.rest, clothed.faces, clothed.joints, mesh.clean),
    )  # fmt: skip


def build_meshes(
    folder: Path, count: int, first: int = 10_000, progress: Callable[[float], None] | None = None
) -> dict[str, list[MeshSample]]:
    """Samples of wardrobe characters by split, computed once.

    Args:
        folder: Where they are kept.
        count: How many characters.
        first: Seed of the first.

    Raises:
        FormatError: A file of the folder is damaged.
    """
    makers = {f"wardrobe_{seed:06d}": partial(_arrays, seed) for seed in range(first, first + count)}
    out: dict[str, list[MeshSample]] = {"train": [], "val": [], "test": []}
    empty = np.zeros(0, np.int64)
    for name, arrays in kept_arrays(folder, makers, progress):
        mesh = SampledMesh(**{key: arrays.pop(key) for key in _MESH}, index=empty, nearest=empty, shares=empty)
        out[character_split(name)].append(MeshSample(name, mesh, **arrays))
    return out


def _arrays(seed: int) -> dict[str, np.ndarray]:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    sample = mesh_sample(wardrobe_character(seed), "", seed)
    arrays = {key: value for key, value in vars(sample).items() if key not in ("name", "mesh")}
    return {key: getattr(sample.mesh, key) for key in _MESH} | arrays


def joint_distances(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, clean_vertices: np.ndarray
) -> np.ndarray:
    """Geodesic distances G of section 4.2 from points to joints, over the height, shape (S, 22), float32.

    The paper lets each joint stand for the vertex nearest to it. Characters are layers of loose parts, so that this may
    be one of a belt or a tooth, and the way from there a long one; and even on a closed limb it is near to one side
    only. Ours begins in the joint itself, goes straight to the nearest vertices on all sides of it, and along the edges
    from there; loose parts are joined wherever they lie on one another, and at least where they are nearest, so that
    all distances are finite.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        clean_vertices: The clean vertices that are asked for (`SampledMesh.clean`), shape (S,).
    """
    clean = clean_mesh(vertices, faces)
    count = len(clean.vertices)
    edges = unique_edges(clean.faces, count)
    part = mesh_parts(edges, count)
    height = max(float(np.ptp(clean.vertices[:, 1])), 1e-9)
    touching = _touching(clean.vertices, part, TOUCH * height)
    edges = np.unique(np.concatenate([edges, bridge_edges(clean.vertices, part), touching]), axis=0)
    lengths = np.linalg.norm(clean.vertices[edges[:, 0]] - clean.vertices[edges[:, 1]], axis=1) + 1e-9
    starts = _starts(clean.vertices, (np.asarray(joints) - clean.center) / clean.scale)
    rows = np.concatenate([edges[:, 0], edges[:, 1], count + starts[0]])
    columns = np.concatenate([edges[:, 1], edges[:, 0], starts[1]])
    ways = np.concatenate([lengths, lengths, starts[2] + 1e-9])  # out of a joint only: no way leads through one
    graph = coo_matrix((ways, (rows, columns)), shape=(count + JOINT_COUNT,) * 2).tocsr()
    found = dijkstra(graph, indices=count + np.arange(JOINT_COUNT))[:, clean_vertices].T
    return np.asarray(found / height, np.float32)


def _touching(vertices: np.ndarray, part: np.ndarray, most: float) -> np.ndarray:
    """Pairs of vertices of different loose parts that lie together, smaller one first, shape (T, 2)."""
    near = min(10, len(vertices))
    gap, other = (found.reshape(len(vertices), near) for found in cKDTree(vertices).query(vertices, near))
    own, rank = np.nonzero((part[other] != part[:, None]) & (gap < most))
    return np.sort(np.stack([own, other[own, rank]], axis=1), axis=1)


def _starts(vertices: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest vertices on all sides of each joint, none much farther off than the nearest of all: numbers of joint
    and vertex, and the distance.
    """
    owners, ends, lengths = [], [], []
    for joint, index in enumerate(joints):
        offset = vertices - index
        gap = np.linalg.norm(offset, axis=1)
        near = np.flatnonzero(gap < REACH * gap.min() + 0.01)
        near = near[np.argsort(gap[near], kind="stable")]
        first = near[np.unique((offset[near] @ _SIDES.T).argmax(axis=1), return_index=True)[1]]
        owners.append(np.full(len(first), joint))
        ends.append(first)
        lengths.append(gap[first])
    return np.concatenate(owners), np.concatenate(ends), np.concatenate(lengths)
