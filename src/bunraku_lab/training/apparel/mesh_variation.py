"""Other makes of the same character: loose parts welded to those they touch, other widths, fewer points.

The wardrobe makes hair of many locks and clothes of whole pieces; models of artists have one shell of hair of which
only the tips move, and coats whose flaps do. Welding the wardrobe's parts gives such masks inside parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.nodes import part_neighbours
from bunraku.apparel.sampled_mesh import point_features
from bunraku_lab.training.apparel.mesh_bank import MeshSample

__all__ = ["varied", "welded_parts"]

TOUCHING = 0.03  # over the height: points of two parts as near may be welded
WIDTH = 0.08  # of the logarithm of what widths are multiplied by
FEWEST = 0.5  # least share of the points that is kept
LEAST = 3  # points of a part that are kept


def welded_parts(
    points: np.ndarray, part: np.ndarray, share: float, random: np.random.Generator, body: bool = False,
    apparel: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Parts after some pairs that touch have become one, numbered from 0, shape (S,).

    Args:
        points: In units of the height, shape (S, 3).
        part: Loose part of each, shape (S,).
        share: Pairs that are welded, over the number of parts.
        random: Which.
        body: Whether the part with the most points may be welded too.
        apparel: Which points are apparel, where parts that have some are welded first, shape (S,).
    """
    numbers, own = np.unique(part, return_inverse=True)
    near = cKDTree(points).query_pairs(TOUCHING, output_type="ndarray")
    pairs = np.sort(own[near], axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if not body:
        pairs = pairs[(pairs != np.bincount(own).argmax()).all(axis=1)]
    pairs = np.stack(np.divmod(np.unique(pairs @ [len(numbers), 1]), len(numbers)), axis=1)
    pairs = random.permutation(pairs)
    if apparel is not None:
        dressed = np.bincount(own, apparel) > 0
        pairs = pairs[np.argsort(~dressed[pairs].all(axis=1), kind="stable")]
    root = np.arange(len(numbers))
    for one, other in pairs[: round(share * len(numbers))]:
        root[root == root[other]] = root[one]
    return np.asarray(np.unique(root[own], return_inverse=True)[1], np.int64)


def varied(sample: MeshSample, random: np.random.Generator) -> MeshSample:
    """A variation of a character, for the segmentation network: its weights and geodesic distances are not changed.

    Args:
        sample: The character.
        random: Of what is changed.
    """
    mesh = sample.mesh
    part = mesh.part
    if random.random() < 0.6:
        first = sample.apparel if random.random() < 0.7 else None
        part = welded_parts(mesh.points, part, 1.5 * random.random() ** 2, random, random.random() < 0.3, first)
    _, own, sizes = np.unique(part, return_inverse=True, return_counts=True)
    kept = random.random(len(part)) < random.uniform(FEWEST, 1, len(sizes))[own]
    rank = np.empty(len(part), np.int64)
    order = np.argsort(own, kind="stable")
    rank[order] = np.arange(len(part)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    rows = np.flatnonzero(kept | (rank < LEAST))
    width = np.exp(random.normal(0, WIDTH, 3) * [1, 0, 1])
    points, joints, part = mesh.points[rows] * width, mesh.joints * width, own[rows]
    normals = mesh.features[rows, 3:6] / width
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    other = replace(
        mesh, clean=mesh.clean[rows], points=points.astype(np.float32), joints=joints.astype(np.float32),
        features=point_features(points, normals, joints, part), part=part, neighbours=part_neighbours(points, part),
    )  # fmt: skip
    return MeshSample(
        sample.name, other, sample.apparel[rows], sample.stiffness[rows], sample.damping[rows], sample.weights[rows],
        sample.geodesics[rows],
    )  # fmt: skip
