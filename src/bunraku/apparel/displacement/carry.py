"""From nodes to vertices: each apparel vertex goes with the nodes around it, their rotations included."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.nodes import ApparelNodes

__all__ = ["Carrier", "node_turns", "polar_rotation"]

NEAR = 4
RIGID = 0.03
"""How much the carrying joint's own rotation counts in that of a node, over the spread of its neighbours."""

ROUND = 2e-3
"""Products of sums of a matrix' singular values, two by two, below which no rotation is nearer than others."""


class Carrier:
    """Takes the displacement of nodes to the apparel vertices of a clothed character.

    Args:
        clothed: The character.
        nodes: Its nodes; every part has some.
    """

    def __init__(self, clothed: ClothedCharacter, nodes: ApparelNodes):
        self.vertices = np.flatnonzero(clothed.part >= 0)
        self.nodes = nodes
        self.index = np.zeros((len(self.vertices), NEAR), np.int64)
        self.share = np.zeros((len(self.vertices), NEAR), np.float32)
        parts = clothed.part[self.vertices]
        for part in np.unique(parts):
            rows, own = np.flatnonzero(parts == part), np.flatnonzero(nodes.part == part)
            near = min(NEAR, len(own))
            gap, found = cKDTree(nodes.rest[own]).query(clothed.rest[self.vertices[rows]], near)
            gap, found = gap.reshape(len(rows), near), found.reshape(len(rows), near)
            # the farthest of the four counts for nothing, so that nothing jumps where another takes its place
            weight = 1 / (gap**2 + 1e-8)
            if near == NEAR:
                weight = np.maximum(weight - weight[:, -1:] * 0.999, 0)
            self.index[rows, :near] = own[found]
            self.share[rows, :near] = weight / weight.sum(axis=1, keepdims=True)
        self._mixed(clothed, nodes)
        neighbours = nodes.rest[nodes.neighbours] - nodes.rest[:, None]
        self.spokes = neighbours.astype(np.float32)
        reach = np.square(self.spokes).sum(axis=(1, 2)) / 3 + 1e-8
        self.prior = (RIGID * reach).astype(np.float32)

    def _mixed(self, clothed: ClothedCharacter, nodes: ApparelNodes) -> None:
        """What of `displacements` and `places` is the same in all frames, as one matrix each."""
        count, rest = len(self.vertices), clothed.rest[self.vertices].astype(np.float32)
        weights = clothed.weights[self.vertices].astype(np.float32)
        whole = np.concatenate([rest, np.ones((count, 1), np.float32)], axis=1)
        self.skin = (weights[:, :, None] * whole[:, None]).reshape(count, -1)
        # a vertex near node i goes to rest_i + moved_i + turn_i (rest - rest_i), and then with its own joint
        pairs = weights.argmax(axis=1)[:, None] * len(nodes) + self.index
        used, number = np.unique(pairs, return_inverse=True)
        self.joint, self.node = np.divmod(used, len(nodes))
        away = np.concatenate([rest[:, None] - nodes.rest[self.index], np.ones((count, NEAR, 1))], axis=2)
        mixed = (self.share[..., None] * away).astype(np.float32)
        columns = 4 * number.reshape(pairs.shape)[..., None] + np.arange(4)
        rows = np.broadcast_to(np.arange(count)[:, None, None], columns.shape)
        kept = mixed != 0
        self.mix = csr_matrix((mixed[kept], (rows[kept], columns[kept])), shape=(count, 4 * len(used)))

    def displacements(self, moved: np.ndarray) -> np.ndarray:
        """Displacement of the apparel vertices in the frames of the joints that carry the nodes [m], shape (A, 3).

        Args:
            moved: Of the nodes, in the frame of the carrying joint each [m], shape (M, 3).
        """
        return np.asarray(self.mix @ self._swung(moved)[self.node].reshape(-1, 3))

    def positions(self, moved: np.ndarray, affine: np.ndarray) -> np.ndarray:
        """Where the apparel vertices are [m], shape (A, 3).

        Args:
            moved: As above.
            affine: Affine transforms of the joints (`eq4_transforms`), shape (22, 3, 4).
        """
        turned = affine.transpose(0, 2, 1).astype(np.float32)  # [R | t]', shape (22, 4, 3)
        swung = np.matmul(self._swung(moved)[self.node], turned[self.joint, :3])
        return np.asarray(self.skin @ turned.reshape(-1, 3) + self.mix @ swung.reshape(-1, 3))

    def _swung(self, moved: np.ndarray) -> np.ndarray:
        """What takes the way from a node to a vertex, and 1 below it, to the vertex' displacement, shape (M, 4, 3)."""
        turns = node_turns(self.nodes, self.spokes, self.prior, moved).transpose(0, 2, 1)
        return np.concatenate([turns - np.eye(3, dtype=np.float32), moved[:, None]], axis=1, dtype=np.float32)


def node_turns(nodes: ApparelNodes, spokes: np.ndarray, prior: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """How nodes turn against the joint that carries them, as their neighbours say (Procrustes), shape (M, 3, 3)."""
    bent = spokes + moved[nodes.neighbours] - moved[:, None]
    product = np.matmul(bent.transpose(0, 2, 1), spokes)
    product[:, [0, 1, 2], [0, 1, 2]] += prior[:, None]
    return polar_rotation(product)


def polar_rotation(matrices: np.ndarray, rounds: int = 10) -> np.ndarray:
    """The rotation nearest to each matrix, shape (..., 3, 3), float32; the identity where none is nearer than others.

    By the fast optimal attitude matrix (Markley 1993): with the sum `s` of the singular values, the last one with the
    sign of the determinant, it is `((k + |B|^2) B + s adj(B)' - B B' B) / (k s - det B)`, `k = (s^2 - |B|^2) / 2`. The
    sum is the largest root of `(s^2 - |B|^2)^2 - 8 s det B - 4 |adj B|^2`, found by Newton's iteration from above.
    """
    shape = np.shape(matrices)
    # one row for each of the nine elements: a few long operations in place of many strided ones
    b = np.array(np.reshape(matrices, (-1, 9)).T, np.float64, order="C")
    b /= np.maximum(np.sqrt(np.einsum("em,em->m", b, b)), 1e-30)
    cofactors = b[_MINORS[0]] * b[_MINORS[1]] - b[_MINORS[2]] * b[_MINORS[3]]
    det = np.einsum("em,em->m", b[:3], cofactors[:3])
    last = 4 * np.einsum("em,em->m", cofactors, cofactors)
    root = np.sqrt(1 + np.sqrt(3 * last))  # |B| is 1, and no sum of three products is over sqrt(3) |adj B|
    for _ in range(rounds):
        square = root * root - 1
        slope = 4 * root * square - 8 * det
        step = (square * square - 8 * det * root - last) / np.where(slope > 1e-12, slope, np.inf)
        root = root - step
        if np.abs(step).max(initial=0) < 1e-12:
            break
    half = 0.5 * (root * root - 1)
    below = half * root - det
    rows = b.reshape(3, 3, -1)
    gram = (rows[:, None] * rows).sum(axis=2)  # B B'
    cubed = (gram[:, :, None] * rows).sum(axis=1).reshape(9, -1)
    found = ((half + 1) * b + root * cofactors - cubed) / np.where(below > ROUND, below, 1.0)
    found = np.where(below > ROUND, found, np.eye(3).reshape(9, 1))
    return np.ascontiguousarray(found.T, np.float32).reshape(shape)


_MINORS = np.array([
    (4, 5, 3, 7, 8, 6, 1, 2, 0), (8, 6, 7, 2, 0, 1, 5, 3, 4), (5, 3, 4, 8, 6, 7, 2, 0, 1), (7, 8, 6, 1, 2, 0, 4, 5, 3),
])  # fmt: skip
"""Elements whose products, the first two less the last two, are the cofactors of a matrix."""
