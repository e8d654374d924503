import numpy as np
import trimesh
from scipy.sparse.csgraph import connected_components

from bunraku_lab.baselines.clusters import cluster_vertices, geodesic_clusters, geodesic_graph
from bunraku_lab.synthetic.samples import make_sample


def test_clusters_are_connected_and_not_empty():
    ball = trimesh.creation.icosphere(4)
    graph = geodesic_graph(ball.vertices, ball.faces)
    label, medoids = cluster_vertices(graph, ball.vertices, np.ones(len(ball.vertices)), 30)
    assert len(medoids) == 30
    sizes = np.bincount(label, minlength=30)
    assert sizes.min() > 0 and sizes.max() < 4 * sizes.mean()
    for cluster in range(30):
        members = np.flatnonzero(label == cluster)
        assert connected_components(graph[members][:, members], directed=False)[0] == 1
        assert medoids[cluster] in members


def test_clusters_do_not_jump_over_gaps():
    """Two bars that almost touch: near in space, far along the surface."""
    left = trimesh.creation.box((0.2, 2, 0.2)).subdivide().subdivide().subdivide()
    right = left.copy().apply_translation([0.21, 0, 0])
    foot = trimesh.creation.box((0.41, 0.2, 0.2)).apply_translation([0.105, -1.1, 0])
    whole = trimesh.util.concatenate([left, right, foot])
    weights = geodesic_clusters(whole.vertices, whole.faces, 8)
    side = (np.arange(len(whole.vertices)) >= len(left.vertices)).astype(int)
    upper = whole.vertices[:, 1] > 0.3
    assert not set(weights[upper & (side == 0)].argmax(1)) & set(weights[upper & (side == 1)].argmax(1))


def test_weights_are_hard_and_the_same_every_time():
    dog = make_sample("dog", detail=0.5)
    weights = geodesic_clusters(dog.vertices, dog.faces)
    assert weights.shape == (len(dog.vertices), 30) and set(np.unique(weights)) == {0, 1}
    np.testing.assert_array_equal(weights.sum(axis=1), 1)
    assert (weights.sum(axis=0) > 0).all()
    np.testing.assert_array_equal(weights, geodesic_clusters(dog.vertices, dog.faces))


def test_more_clusters_than_vertices_leave_some_empty():
    box = trimesh.creation.box()
    weights = geodesic_clusters(box.vertices, box.faces, 30)
    assert weights.shape == (8, 30) and (weights.sum(axis=1) == 1).all() and len(set(weights.argmax(1))) == 8
