"""Geodesic k-means: the mesh cut into connected pieces of about the same size, without any idea of its parts.

The plainest skinning there is, to compare handles with: each piece moves rigidly and on its own.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from bunraku.geometry.graph import bridge_edges, clean_mesh, mesh_parts, unique_edges
from bunraku.geometry.surface import vertex_areas

__all__ = ["cluster_vertices", "geodesic_clusters", "geodesic_graph"]

_MEDOIDS = 24  # vertices near a cluster's mean that are tried as its medoid


def geodesic_graph(vertices: np.ndarray, faces: np.ndarray) -> csr_matrix:
    """Lengths of the edges of a mesh, loose parts joined by bridges, shape (V, V), symmetric.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
    """
    edges = unique_edges(faces, len(vertices))
    edges = np.concatenate([edges, bridge_edges(vertices, mesh_parts(edges, len(vertices)))])
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    lengths = np.maximum(lengths, 1e-9)  # an edge of length 0 would not be stored
    both = np.concatenate([edges, edges[:, ::-1]])
    return csr_matrix((np.tile(lengths, 2), (both[:, 0], both[:, 1])), shape=(len(vertices),) * 2)


def _seeds(graph: csr_matrix, areas: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """First medoids by k-means++ (Arthur & Vassilvitskii 2007) with geodesic distances."""
    chosen = [int(rng.choice(len(areas), p=areas / areas.sum()))]
    nearest = dijkstra(graph, indices=chosen[0])
    for _ in range(count - 1):
        score = areas * nearest**2
        if score.sum() <= 0:
            break
        chosen.append(int(rng.choice(len(areas), p=score / score.sum())))
        nearest = np.minimum(nearest, dijkstra(graph, indices=chosen[-1], limit=float(nearest.max())))
    return np.array(chosen)


def _medoid(graph: csr_matrix, members: np.ndarray, points: np.ndarray, areas: np.ndarray) -> int:
    """The member with the least area-weighted sum of squared geodesic distances to the others, among those near their
    mean.
    """
    mean = np.average(points[members], axis=0, weights=areas[members])
    order = np.argsort(np.square(points[members] - mean).sum(axis=1), kind="stable")
    tried = order[:: max(1, len(order) // (4 * _MEDOIDS))][:_MEDOIDS]
    distances = dijkstra(graph[members][:, members], indices=tried)
    return int(members[tried[(distances**2 @ areas[members]).argmin()]])


def cluster_vertices(
    graph: csr_matrix, points: np.ndarray, areas: np.ndarray, count: int = 30, seed: int = 0, rounds: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """Lloyd's algorithm with geodesic distances and medoids.

    Args:
        graph: Lengths of the edges, one connected graph, shape (V, V).
        points: Positions, shape (V, 3).
        areas: Surface of each vertex, above 0, shape (V,).
        count: Clusters; no more than there are vertices.
        seed: Of the first medoids.
        rounds: Most rounds; it stops earlier where nothing changes.

    Returns:
        The cluster of each vertex (V,), each connected and none empty, and the medoids (K,).
    """
    medoids = _seeds(graph, areas, min(count, len(points)), np.random.default_rng(seed))
    for _ in range(rounds):
        label = _assigned(graph, medoids)
        order = np.argsort(label, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        moved = np.array([_medoid(graph, members, points, areas) for members in groups])
        if (moved == medoids).all():
            break
        medoids = moved
    return _assigned(graph, medoids), medoids


def _assigned(graph: csr_matrix, medoids: np.ndarray) -> np.ndarray:
    """Number of the medoid that is nearest to each vertex along the surface, shape (V,)."""
    _, _, source = dijkstra(graph, indices=medoids, min_only=True, return_predecessors=True)
    number = np.zeros(graph.shape[0], np.int64)
    number[medoids] = np.arange(len(medoids))
    return number[source]


def geodesic_clusters(vertices: np.ndarray, faces: np.ndarray, count: int = 30, seed: int = 0) -> np.ndarray:
    """Hard skinning weights of geodesic k-means clusters.

    Args:
        vertices: Positions [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        count: Clusters.
        seed: Of the first medoids.

    Returns:
        One 1 a row, shape (V, count), float32.
    """
    mesh = clean_mesh(vertices, faces)
    areas = vertex_areas(mesh.vertices, mesh.faces) + 1e-12
    label, _ = cluster_vertices(geodesic_graph(mesh.vertices, mesh.faces), mesh.vertices, areas, count, seed)
    return np.eye(count, dtype=np.float32)[label[mesh.index]]
