"""How deep points are in a body, against a ball, of which it is known."""

import numpy as np
import pytest
import trimesh

from bunraku.apparel.body_depth import BAND, CELL, OUTSIDE, Unposed, body_depth
from bunraku.body.layout import JOINT_COUNT
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.geometry.winding import winding_numbers

RADIUS = 0.3


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(4, RADIUS)
    weights = np.zeros((len(mesh.vertices), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    none = np.zeros(len(mesh.vertices), bool)
    return body_depth(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces), weights, none)


def test_distances_from_a_ball(ball):
    random = np.random.default_rng(0)
    points = random.uniform(-0.4, 0.4, (500, 3)).astype(np.float32)
    found, slope = ball.at(points)
    true = np.linalg.norm(points, axis=1) - RADIUS
    wanted = np.clip(true, -BAND, BAND)
    near = (true > -BAND + 1.8 * CELL) & (true < (OUTSIDE - 1.8) * CELL)
    assert np.abs(found - wanted)[near].max() < 0.1 * CELL
    inside = true < 0
    assert np.abs(found - wanted)[inside].max() < CELL and np.abs(found - wanted).max() < 2 * CELL
    outward = points[near] / np.linalg.norm(points[near], axis=1, keepdims=True)
    assert (slope[near] * outward).sum(axis=1).min() > 0.95
    # beyond the grid it is as far as anything is, and its middle is inside although no face is near
    assert ball.at(np.array([[9.0, 0, 0], [0, 0, 0]], np.float32))[0].tolist() == pytest.approx([BAND, -BAND])


def test_points_are_pushed_out_in_any_pose(ball):
    turn = matrix_from_axis_angle(np.array([0.4, -1.0, 0.7]))
    shift = np.array([1.0, 2.0, -0.5])
    rest = np.array([[0.25, 0, 0], [0, 0.31, 0], [0, 0, 0.26], [0, 0.35, 0.1]])
    points = (rest @ turn.T + shift).astype(np.float32)
    blend = np.repeat(np.concatenate([turn, shift[:, None]], axis=1)[None], 4, axis=0)
    unposed = Unposed.of(blend, np.zeros(4, np.int64))
    gap = np.array([0.02, 0.02, -0.05, 0.02], np.float32)
    moved = (ball.pushed(points, unposed, gap, 0.1) - shift) @ turn
    assert np.linalg.norm(moved, axis=1) == pytest.approx([0.32, 0.32, 0.26, np.hypot(0.35, 0.1)], abs=2e-3)
    np.testing.assert_allclose(moved[3], rest[3], atol=1e-6)
    np.testing.assert_allclose(ball.pushed(points, unposed, gap, 0.005)[0], points[0], atol=1e-6)  # too deep


def test_only_points_near_the_body_are_looked_at_and_none_is_missed(ball):
    """Against the distance of every point: whoever is less far than its gap, by less than the most, is moved."""
    random = np.random.default_rng(1)
    points = random.uniform(-0.4, 0.4, (3000, 3)).astype(np.float32)
    gap = random.uniform(-0.05, 0.5 * CELL, len(points)).astype(np.float32)
    still = np.tile(np.eye(3, 4, dtype=np.float32), (len(points), 1, 1))
    rows, step = ball.push(points, Unposed.of(still, np.zeros(len(points), np.int64)), gap, 0.08)
    distance, slope = ball.at(points)
    short = gap - distance
    np.testing.assert_array_equal(rows, np.flatnonzero((short > 0) & (short < 0.08)))
    wanted = short[rows, None] * slope[rows] / np.maximum(np.square(slope[rows]).sum(axis=1), 0.1)[:, None]
    np.testing.assert_allclose(step, wanted, atol=1e-6)
    assert 200 < len(rows) < 2000


def test_what_is_all_apparel_has_no_body():
    mesh = trimesh.creation.icosphere(1, RADIUS)
    count = len(mesh.vertices)
    weights = np.ones((count, JOINT_COUNT), np.float32) / JOINT_COUNT
    assert body_depth(np.asarray(mesh.vertices), np.asarray(mesh.faces), weights, np.ones(count, bool)) is None


def test_a_body_is_measured_once_and_another_anew(ball):
    mesh = trimesh.creation.icosphere(4, RADIUS)
    weights = np.zeros((len(mesh.vertices), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    none, vertices = np.zeros(len(mesh.vertices), bool), np.asarray(mesh.vertices, np.float32)
    first = body_depth(vertices, np.asarray(mesh.faces), weights, none)
    assert body_depth(vertices.copy(), np.asarray(mesh.faces), weights, none) is first
    larger = body_depth(vertices * np.float32(1.1), np.asarray(mesh.faces), weights, none)
    assert larger.values.shape != first.values.shape or not np.array_equal(larger.values, first.values)


def test_a_body_with_a_hole_is_closed_in_the_middle_of_it():
    """A ball without a cap, whose inside is told from its outside by winding numbers at every point of the grid."""
    mesh = trimesh.creation.icosphere(4, RADIUS)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces)
    faces = faces[(vertices[faces][:, :, 1] < 0.8 * RADIUS).all(axis=1)]
    weights = np.zeros((len(vertices), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    grid = body_depth(vertices, faces, weights, np.zeros(len(vertices), bool))
    shape = np.array(grid.values.shape)
    points = grid.low + grid.cell * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    near = np.abs(grid.values) < BAND - CELL
    inside = np.abs(winding_numbers(points[near].astype(np.float64), vertices, faces)) > 0.5
    assert inside.any() and not inside.all()
    assert np.mean((grid.values[near] < 0) == inside) > 0.9995
