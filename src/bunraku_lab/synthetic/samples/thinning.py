"""A mesh with fewer triangles: short edges collapse, many at once."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

__all__ = ["thinned"]

_SHARE = 0.25
"""Of all edges the shortest that a round looks at, so that long ones wait until no short one is left."""


def thinned(positions: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse edges to their middle, the short ones first, until no more than so many faces are left.

    An edge collapses where that keeps the surface a surface: its ends share no neighbours but those of its own faces
    (Dey et al. 1999, "Topology preserving edge contraction"). A border stays where it is but for its own edges.

    Args:
        positions: Vertices, in any number of dimensions in which lengths are taken, shape (V, D).
        faces: Of a surface in which an edge has one face or two, shape (F, 3).
        most: Faces.

    Returns:
        Positions (W, D) and faces, shape (G, 3), int64.
    """
    positions, faces = np.array(positions, float), np.asarray(faces, np.int64)
    while len(faces) > most:
        count = len(positions)
        ends, uses = _edges(faces)
        border = np.zeros(count, bool)
        border[ends[uses == 1]] = True
        length = np.square(positions[ends[:, 0]] - positions[ends[:, 1]]).sum(axis=1)
        links = sp.csr_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
        links = links + links.T
        some = np.argsort(length, kind="stable")[: max(int(_SHARE * len(ends)), 100)]
        a, b = ends[some].T
        shared = np.asarray(links[a].multiply(links[b]).sum(axis=1)).ravel()
        degree = np.diff(links.indptr)
        # an inner edge between two border vertices would pinch the surface, and one of a tetrahedron would flatten it
        sound = (shared == uses[some]) & ((uses[some] == 1) | ~(border[a] & border[b]))
        sound &= np.maximum(degree[a], degree[b]) > uses[some] + 1
        chosen = some[sound]
        chosen = chosen[_apart(links, *ends[chosen].T)]
        if not len(chosen):
            break
        spare = len(faces) - most
        chosen = chosen[: max(int(np.searchsorted(np.cumsum(uses[chosen]), spare)), 1)]
        a, b = ends[chosen].T
        middle = 0.5 * (positions[a] + positions[b])
        for one, other in ((a, b), (b, a)):
            kept = border[one] & ~border[other]
            middle[kept] = positions[one[kept]]
        positions[a] = middle
        becomes = np.arange(count)
        becomes[b] = a
        faces = becomes[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        used, inverse = np.unique(faces, return_inverse=True)
        positions, faces = positions[used], inverse.reshape(-1, 3)
    return positions, faces


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges, smaller vertex first, shape (E, 2), and how many faces each has, shape (E,)."""
    count = int(faces.max()) + 1
    a, b = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key, uses = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_counts=True)
    return np.stack([key // count, key % count], axis=1), uses


def _apart(links: sp.csr_matrix, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which of some edges, given in order of preference, may collapse at once: no edge joins two of them, shape (E,).

    Those that come first among all that touch their ends or a neighbour of these.
    """
    rank = np.arange(len(a))
    first = np.full(links.shape[0], len(a))
    np.minimum.at(first, a, rank)
    np.minimum.at(first, b, rank)
    around = np.minimum(first, np.minimum.reduceat(np.append(first, len(a))[links.indices], links.indptr[:-1]))
    return np.asarray((rank == around[a]) & (rank == around[b]))
