"""Other tessellations, holes and loose parts for training examples.

Everything here moves or merges whole rows of an example, so that its weights, labels and poses stay exactly true: a
vertex that slides towards its neighbour takes the same share of the neighbour's weights and of its posed positions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from bunraku_lab.datasets.characters.training_character import TrainingMesh

__all__ = ["MeshAugmentation", "coarser", "augment_mesh", "noisy", "pierced", "slid", "split"]


@dataclass(frozen=True)
class MeshAugmentation:
    """How often and how much examples are damaged.

    Args:
        slide_rate: Share of the examples whose vertices slide along the surface.
        slide: Largest way towards a neighbour, as a share of the edge.
        coarse_rate: Share of the examples that lose vertices.
        coarse: Largest share of the vertices that merge with a neighbour.
        hole_rate: Share of the examples with holes.
        hole: Largest radius of a hole, in units of the largest extent.
        split_rate: Share of the examples that are cut into loose parts.
        noise: Largest standard deviation of the noise on positions, in units of the largest extent.
        normal_noise: Largest standard deviation of the noise on normals.
    """

    slide_rate: float = 0.5
    slide: float = 0.4
    coarse_rate: float = 0.4
    coarse: float = 0.45
    hole_rate: float = 0.2
    hole: float = 0.1
    split_rate: float = 0.25
    noise: float = 0.004
    normal_noise: float = 0.12


_ROWS = ("vertices", "normals", "weights", "target")


def _random_neighbour(edges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """A neighbour of each vertex, itself where it has none, shape (V,)."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[rng.permutation(len(both))]
    chosen = np.arange(count)
    chosen[both[:, 0]] = both[:, 1]  # of repeated indices the last one counts, and the order is random
    return chosen


def slid(mesh: TrainingMesh, rng: np.random.Generator, most: float) -> TrainingMesh:
    """Every vertex goes up to `most` of the way to one of its neighbours."""
    count = len(mesh.vertices)
    neighbour = _random_neighbour(mesh.edges, count, rng)
    share = (most * rng.random(count)).astype(np.float32)[:, None]
    moved = {name: (1 - share) * getattr(mesh, name) + share * getattr(mesh, name)[neighbour] for name in _ROWS}
    posed = (1 - share) * mesh.posed + share * mesh.posed[:, neighbour]
    return replace(mesh, **moved, posed=posed)


def coarser(mesh: TrainingMesh, rng: np.random.Generator, share: float) -> TrainingMesh:
    """About a share of the vertices merge with a neighbour; rows become means by area."""
    count = len(mesh.vertices)
    gone = rng.random(count) < share
    neighbour = _random_neighbour(mesh.edges, count, rng)
    into = np.where(gone & ~gone[neighbour], neighbour, np.arange(count))
    kept, label = np.unique(into, return_inverse=True)
    label = label.reshape(-1)
    areas = np.bincount(label, mesh.areas, len(kept)).astype(np.float32)
    even = mesh.areas + 1e-9
    mean = csr_matrix((even / np.bincount(label, even)[label], (label, np.arange(count))), shape=(len(kept), count))
    rows: dict[str, Any] = {name: np.asarray(mean @ getattr(mesh, name), np.float32) for name in _ROWS}
    frames = len(mesh.posed)
    flat = np.ascontiguousarray(mesh.posed.transpose(1, 0, 2)).reshape(count, -1)
    posed = np.asarray(mean @ flat, np.float32).reshape(len(kept), frames, 3).transpose(1, 0, 2)
    return replace(
        mesh, **rows, areas=areas, edges=_relabelled(mesh.edges, label, len(kept)), posed=np.ascontiguousarray(posed)
    )


def _relabelled(edges: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    ends = np.sort(label[edges], axis=1)
    ends = ends[ends[:, 0] != ends[:, 1]]
    keys = np.unique(ends[:, 0] * count + ends[:, 1])
    return np.stack([keys // count, keys % count], axis=1)


def pierced(mesh: TrainingMesh, rng: np.random.Generator, radius: float, holes: int = 3) -> TrainingMesh:
    """Balls around random vertices are cut out, a tenth of the vertices at most."""
    keep = np.ones(len(mesh.vertices), bool)
    for _ in range(int(rng.integers(1, holes + 1))):
        middle = mesh.vertices[rng.integers(len(keep))]
        hole = np.linalg.norm(mesh.vertices - middle, axis=1) < radius * rng.uniform(0.3, 1)
        if (~(keep & ~hole)).mean() < 0.1:
            keep &= ~hole
    index = np.cumsum(keep) - 1
    edges = index[mesh.edges[keep[mesh.edges].all(axis=1)]]
    rows = {name: getattr(mesh, name)[keep] for name in (*_ROWS, "areas")}
    return replace(mesh, **rows, edges=edges, posed=np.ascontiguousarray(mesh.posed[:, keep]))


def split(mesh: TrainingMesh, rng: np.random.Generator) -> TrainingMesh:
    """Edges between parts are cut, all but a few that stand for the bridges which network meshes have between loose
    parts.

    The parts are those of the rig, or what a random plane parts.
    """
    if rng.random() < 0.6:
        side = mesh.weights.argmax(axis=1)
    else:
        normal = rng.normal(size=3)
        along = mesh.vertices @ (normal / np.linalg.norm(normal))
        side = (along > np.quantile(along, rng.uniform(0.15, 0.85))).astype(np.int64)
    cut = side[mesh.edges[:, 0]] != side[mesh.edges[:, 1]]
    cut &= rng.random(len(cut)) > 0.05
    return replace(mesh, edges=mesh.edges[~cut])


def noisy(mesh: TrainingMesh, rng: np.random.Generator, positions: float, normals: float) -> TrainingMesh:
    """Noise on the positions, the same in all poses, and on the normals, whose lengths stay near theirs."""
    shift = rng.normal(0, positions, mesh.vertices.shape).astype(np.float32)
    turn = rng.normal(0, normals, mesh.normals.shape).astype(np.float32)
    return replace(mesh, vertices=mesh.vertices + shift, normals=mesh.normals + turn, posed=mesh.posed + shift)


def augment_mesh(mesh: TrainingMesh, rng: np.random.Generator, config: MeshAugmentation | None = None) -> TrainingMesh:
    """The example with its surface changed at random.

    Args:
        mesh: An example.
        rng: Source of randomness.
        config: How often and how much.
    """
    config = config or MeshAugmentation()
    if rng.random() < config.split_rate:
        mesh = split(mesh, rng)
    if rng.random() < config.coarse_rate:
        mesh = coarser(mesh, rng, config.coarse * rng.random())
    if rng.random() < config.hole_rate:
        mesh = pierced(mesh, rng, config.hole)
    if rng.random() < config.slide_rate:
        mesh = slid(mesh, rng, config.slide)
    if config.noise > 0 or config.normal_noise > 0:
        mesh = noisy(mesh, rng, config.noise * rng.random(), config.normal_noise * rng.random())
    return mesh
