"""Pieces of apparel: what is one sheet, however many walls it has."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from bunraku.physics.chains.sheets import _through


def _wall(radius: float) -> np.ndarray:
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), np.linspace(1.0, 0.5, 26))
    return np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)


def test_both_walls_of_a_skirt_reach_as_far() -> None:
    """Two walls, 3 cm apart and nowhere joined, of which the outer one alone is held at its upper edge."""
    outer, inner = _wall(0.3), _wall(0.27)
    points = np.concatenate([outer, inner])
    pairs = _through(points, 1.6)
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    graph = coo_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points))).tocsr()
    along = dijkstra(graph.maximum(graph.T), indices=np.flatnonzero(outer[:, 1] > 0.99), min_only=True)
    assert np.isfinite(along).all()
    assert np.abs(along[: len(outer)] - along[len(outer) :]).max() < 0.06
    assert abs(along.max() - 0.5) < 0.08
