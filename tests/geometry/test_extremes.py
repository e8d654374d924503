"""Extreme points: the lowest vertex must be among them however a body is turned."""

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bunraku.body.reference import reference_body
from bunraku.geometry.extremes import extreme_points, part_extremes


def test_corners_of_a_box_are_its_extreme_points():
    rng = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
    points = np.concatenate([rng.uniform(0.1, 0.9, (500, 3)), corners])
    assert extreme_points(points).tolist() == list(range(500, 508))


def test_they_are_on_the_convex_hull_and_hardly_miss_any_of_it():
    points = np.random.default_rng(1).normal(size=(3000, 3)) * [1, 2, 0.5]
    picked = extreme_points(points, 160)
    assert set(picked) <= set(ConvexHull(points.astype(np.float32)).vertices)
    for turn in Rotation.random(50, random_state=0):
        heights = turn.apply(points)[:, 1]
        assert heights[picked].min() - heights.min() < 0.03 * np.ptp(heights)


def test_the_lowest_of_a_body_is_among_those_of_its_parts():
    body = reference_body()
    picked = part_extremes(body.vertices, body.handle_weights)
    assert len(picked) < 0.7 * len(body.vertices)
    for turn in Rotation.random(50, random_state=0):
        heights = turn.apply(body.vertices)[:, 1]
        assert heights[picked].min() - heights.min() < 2e-3


def test_no_vertices_have_no_extremes():
    assert len(part_extremes(np.zeros((0, 3)), np.zeros((0, 30)))) == 0
