"""Where apparel and body meet, and what the joint refinement of section 4.4 reads of each vertex there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.skinning import skin
from bunraku.geometry.graph import clean_mesh, unique_edges

__all__ = ["BASIS", "INPUTS", "Seam", "SeamFrame", "seam_of"]

REACH = 0.12
"""How far from apparel the body is refined too, along the edges, over the character's size [m]."""
HOPS = (1, 4, 12)
"""Edges over which what surrounds a vertex is averaged."""
BASIS = len(HOPS) + 2
"""Vectors that a refinement may be made of: the ways to the means around a vertex, what would even out its edges, and
the way back to where the body alone has it."""
INPUTS = 3 * BASIS + len(HOPS) + 2
_SPREAD = 0.02  # of the vectors, over the character's size


@dataclass(frozen=True, eq=False)
class SeamFrame:
    """One frame of S vertices.

    Args:
        vectors: In the frames of the carrying joints, over the size, shape (S, BASIS, 3), float32.
        inputs: Input of the network, shape (S, INPUTS), float32.
        turns: Frames of the carrying joints, shape (S, 3, 3), float32.
    """

    vectors: np.ndarray
    inputs: np.ndarray
    turns: np.ndarray


@dataclass(frozen=True, eq=False)
class Seam:
    """Apparel and the body about it, of one clothed character.

    Args:
        vertices: One of each position on the mesh, shape (S,).
        copies: All vertices of these positions, shape (C,), and the row of each.
        rows: As said.
        edges: Between them, rows, shape (E, 2).
        lengths: Of the edges at rest [m], shape (E,).
        weights: Skinning weights that the body alone would have there, shape (S, 22).
        rest: [m], shape (S, 3).
        joint: Joint that carries each, by these weights, shape (S,).
        still: Inputs that never change: apparel or not, its means around, and how many edges meet, shape
            (S, len(HOPS) + 2).
        around: Mean over the neighbours and the vertex itself, sparse (S, S).
        scale: The clothed's size.
    """

    vertices: np.ndarray
    copies: np.ndarray
    rows: np.ndarray
    edges: np.ndarray
    lengths: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    joint: np.ndarray
    still: np.ndarray
    around: csr_matrix
    scale: float

    def frame(self, positions: np.ndarray, affine: np.ndarray) -> SeamFrame:
        """Features of one frame.

        Args:
            positions: Both modules' results tiled, of all vertices of the mesh [m], shape (V, 3).
            affine: Affine transforms of the joints, shape (22, 3, 4).
        """
        now = np.asarray(positions[self.vertices], np.float32)
        body = np.asarray(skin(self.rest, self.weights, affine[None])[0], np.float32)
        away = now - body
        means, smooth, done = [], away, 0
        for hops in HOPS:
            for _ in range(hops - done):
                smooth = self.around @ smooth
            means.append(smooth - away)
            done = hops
        world = np.stack([*means, self._evened(now), -away], axis=1) / np.float32(self.scale)
        turns = np.asarray(affine[self.joint, :, :3], np.float32)
        vectors = np.einsum("sba,skb->ska", turns, world)
        inputs = np.concatenate([np.clip(vectors.reshape(len(now), -1) / _SPREAD, -6, 6), self.still], axis=1)
        return SeamFrame(vectors, inputs.astype(np.float32), turns)

    def _evened(self, now: np.ndarray) -> np.ndarray:
        """Half of what edges are too long or too short by, along them, mean over those of a vertex, shape (S, 3)."""
        a, b = self.edges.T
        way = now[b] - now[a]
        length = np.linalg.norm(way, axis=1)
        step = way * (0.5 * (1 - self.lengths / np.maximum(length, 1e-9)))[:, None]
        count = np.maximum(np.bincount(self.edges.reshape(-1), minlength=len(now)), 1)[:, None]
        total = [np.bincount(a, column, len(now)) - np.bincount(b, column, len(now)) for column in step.T]
        return np.asarray(np.stack(total, axis=1) / count, np.float32)


def seam_of(clothed: ClothedCharacter, weights: np.ndarray) -> Seam:
    """The seam of a clothed character.

    Args:
        clothed: The character.
        weights: Skinning weights that the body alone would give all vertices, shape (V, 22).
    """
    clean = clean_mesh(clothed.rest, clothed.faces)
    count, size = len(clean.vertices), clothed.scale
    cloth = np.zeros(count, bool)
    cloth[clean.index[clothed.apparel]] = True
    edges = unique_edges(clean.faces, count)
    points = clean.vertices * clean.scale
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    graph = coo_matrix((lengths + 1e-9, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    starts = np.flatnonzero(cloth)
    if len(starts):
        near = dijkstra(graph, directed=False, indices=starts, min_only=True, limit=REACH * size)
        kept = np.flatnonzero(np.isfinite(near))
    else:
        kept = starts
    index = np.full(count, -1)
    index[kept] = np.arange(len(kept))
    inside = (index[edges] >= 0).all(axis=1)
    edges, lengths = index[edges[inside]], lengths[inside]
    first = np.zeros(count, np.int64)
    first[clean.index[::-1]] = np.arange(len(clean.index))[::-1]
    vertices = first[kept]
    rows = index[clean.index]
    copies = np.flatnonzero(rows >= 0)
    here = np.arange(len(kept))
    pairs = np.concatenate([edges, edges[:, ::-1], np.stack([here, here], axis=1)])
    around = coo_matrix((np.ones(len(pairs), np.float32), pairs.T), shape=(len(kept),) * 2).tocsr()
    degree = np.asarray(around.sum(axis=1)).reshape(-1)
    around = csr_matrix(around.multiply(1 / np.maximum(degree, 1)[:, None]), dtype=np.float32)
    mask = cloth[kept].astype(np.float32)
    still, smooth, done = [mask], mask, 0
    for hops in HOPS:
        for _ in range(hops - done):
            smooth = around @ smooth
        still.append(smooth)
        done = hops
    still.append(np.asarray(degree / 8, np.float32))
    own = np.asarray(weights[vertices], np.float32)
    return Seam(
        vertices, copies, rows[copies], edges, lengths.astype(np.float32), own, np.asarray(clothed.rest[vertices]),
        own.argmax(axis=1) if len(own) else np.zeros(0, np.int64), np.stack(still, axis=1), around, size,
    )  # fmt: skip
