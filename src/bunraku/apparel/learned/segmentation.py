"""The apparel of any mesh, found by the segmentation network f_c (MMDMC 4.1) on a few points of its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import SOFTEST, STIFFEST
from bunraku.apparel.nodes import EdgeBlock, NodeGraph, part_neighbours
from bunraku.core.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import vertex_normals
from bunraku.core.nn.checkpoints import config_of, dated_checkpoint, load_network
from bunraku.core.nn.layers import Weights, gelu, one_thread

POINTS = 1024
POINT_FEATURES = 3 + 3 + 3 + 1 + JOINT_COUNT - 1 + 4
_BONES = [(parent, joint) for joint, parent in enumerate(JOINT_PARENTS) if parent >= 0]


@dataclass(frozen=True, eq=False)
class SampledMesh:
    """S points of a mesh."""

    clean: np.ndarray  # clean vertex (`geometry.graph.clean_mesh`) that each is, shape (S,)
    points: np.ndarray  # in units of the height, feet at 0, x and z from the pelvis, shape (S, 3), float32
    joints: np.ndarray  # J in the same units, shape (22, 3)
    features: np.ndarray  # input of the segmentation network, shape (S, POINT_FEATURES), float32
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
    features = point_features(points, vertex_normals(clean.vertices, clean.faces)[chosen], bones, part[chosen])
    nearest, shares = _near(positions, part, chosen)
    return SampledMesh(
        chosen, points.astype(np.float32), bones.astype(np.float32), features, part[chosen],
        part_neighbours(positions[chosen], part[chosen]), clean.index, nearest[clean.index], shares[clean.index],
    )  # fmt: skip


def point_features(points: np.ndarray, normals: np.ndarray, joints: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Input of the segmentation network for points and normals as of `SampledMesh`, shape (S, POINT_FEATURES), float32:
    position, normal, the vector from the nearest bone and its length, how near each bone is, the extent of the point's
    loose part, its height above the part's lowest point.
    """
    numbers, index = np.unique(part, return_inverse=True)
    sides = np.array([(points[index == number].min(axis=0), points[index == number].max(axis=0))
                      for number in range(len(numbers))])  # fmt: skip
    low, high = sides[index, 0], sides[index, 1]
    offset, gaps = _bone_ways(points, joints)
    features = np.concatenate([
        points, normals, offset, gaps.min(axis=1, keepdims=True), np.exp(-8 * gaps), high - low,
        (points[:, 1] - low[:, 1])[:, None],
    ], axis=1)  # fmt: skip
    return np.asarray(features, np.float32)


def _chosen(part: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """At least three vertices of every part, as far as there is room; the rest by the share of vertices."""
    order = rng.permutation(len(part))
    rank = np.empty(len(part), np.int64)
    by_part = order[np.argsort(part[order], kind="stable")]
    starts = np.searchsorted(part[by_part], part[by_part])
    rank[by_part] = np.arange(len(part)) - starts
    priority = np.where(rank < 3, rank - 3.0, rng.random(len(part)))
    return np.sort(np.argsort(priority, kind="stable")[:most])


def _bone_ways(points: np.ndarray, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vector from the nearest of the 21 bones to each point (S, 3), and the distance to each bone (S, 21)."""
    start, end = (joints[[bone[side] for bone in _BONES]] for side in (0, 1))
    along = end - start
    share = np.einsum("sba,ba->sb", points[:, None] - start, along) / np.maximum(np.square(along).sum(axis=1), 1e-9)
    feet = start + np.clip(share, 0, 1)[..., None] * along
    ways = points[:, None] - feet
    gaps = np.linalg.norm(ways, axis=2)
    return ways[np.arange(len(points)), gaps.argmin(axis=1)], gaps


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


@dataclass(frozen=True)
class SegmentationConfig:
    """Shape of the network: channels, and edge convolutions within loose parts."""

    width: int = 96
    blocks: int = 2


class SegmentationNetwork:
    """The network.

    Raises:
        ValueError: The weights have other sizes than the config.
    """

    def __init__(self, config: SegmentationConfig, weights: Weights):
        self.config = config
        width = config.width
        self._mean, self._std = weights.array("mean", POINT_FEATURES), weights.array("std", POINT_FEATURES)
        self._enter = weights.linear("enter.0", POINT_FEATURES, width), weights.linear("enter.2", width, width)
        self._blocks = [EdgeBlock(width, weights.part(f"blocks.{index}")) for index in range(config.blocks)]
        self._pooled = weights.linear("pooled", width, width)
        self._decoder = weights.linear("decoder.0", 2 * width, width), weights.linear("decoder.2", width, 3)

    def scores(self, mesh: SampledMesh) -> np.ndarray:
        """Before the sigmoid: apparel, stiffness, log10 of what a second of damping leaves, of each point, (S, 3)."""
        graph = NodeGraph(mesh.neighbours, mesh.part)
        scaled = np.clip((mesh.features - self._mean) / self._std, -6, 6)
        x = self._enter[1](gelu(self._enter[0](scaled)))
        for block in self._blocks:
            x = block(x, graph)
        summary = np.broadcast_to(self._pooled(x.max(axis=0, keepdims=True)), x.shape)
        return self._decoder[1](gelu(self._decoder[0](np.concatenate([x, summary], axis=1))))


def load_segmentation(path: str | Path) -> SegmentationNetwork:
    """Read a checkpoint of kind "apparel-mask", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(
        path, "apparel-mask", lambda shape, weights: SegmentationNetwork(config_of(SegmentationConfig, shape), weights)
    )


VIEWS = 3  # samples of the mesh whose answers are averaged
LIKELY = 1 / 3
"""Probability from which on a vertex is apparel: where edges are in doubt, less than a half makes the most of the
intersection over the union (0.739 in place of 0.719 on 44 characters for validation).
"""


@dataclass(frozen=True, eq=False)
class FoundApparel:
    """The network's answer for each vertex of a mesh."""

    likely: np.ndarray  # probability to be apparel, shape (V,)
    stiffness: np.ndarray  # as of `ClothedCharacter`, shape (V,)
    damping: np.ndarray  # share of the velocity that is lost in a second, shape (V,)

    @property
    def mask(self) -> np.ndarray:
        """Vertices that are apparel, shape (V,), bool."""
        return np.asarray(self.likely > LIKELY)


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> SegmentationNetwork:
    return load_segmentation(path)


def find_apparel(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, checkpoint: str | Path | None = None
) -> FoundApparel:
    """Which vertices are apparel, and how stiff they are.

    Args:
        vertices, faces: Rest mesh V [m], +Y up and facing +Z, shapes (V, 3) and (F, 3).
        joints: J [m], shape (22, 3).
        checkpoint: Weights of kind "apparel-mask" in place of the shipped ones.

    Raises:
        CharacterError: The mesh is broken.
        WeightsError: The checkpoint is missing or does not fit.
    """
    model = _model(*dated_checkpoint("apparel-mask", checkpoint))
    total = np.zeros((len(vertices), 3))
    with one_thread():
        for seed in range(VIEWS):
            mesh = sampled_mesh(vertices, faces, joints, POINTS, seed)
            scores = model.scores(mesh).astype(np.float64)
            scores[:, 0] = 1 / (1 + np.exp(-np.clip(scores[:, 0], -30, 30)))
            total += mesh.spread(scores)
    likely, stiffness, left = (total / VIEWS).T
    return FoundApparel(
        likely.astype(np.float32), np.clip(stiffness, SOFTEST, STIFFEST).astype(np.float32),
        np.clip(1 - 10.0**left, 0, 0.999).astype(np.float32),
    )  # fmt: skip
