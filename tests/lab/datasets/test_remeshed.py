"""Surfaces remade by voxels, held against bodies whose surfaces are known."""

import numpy as np
import pytest

from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError
from bunraku.samples import sample_character
from bunraku_lab.datasets.characters.remeshed import blocky_surface, fused_surface, on_plinth
from bunraku_lab.datasets.characters.surfaces import build_surfaces, clip_poses, load_surfaces, remade


def ball(middle, radius, count=40_000):
    points = np.random.default_rng(3).normal(size=(count, 3))
    return middle + radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_the_skin_of_a_ball_is_that_ball():
    points, normals = fused_surface(ball(np.array([1.0, 2.0, 3.0]), 0.5), 40, 2000, np.random.default_rng(0))
    away = points - [1, 2, 3]
    cell = 1 / 40
    assert np.abs(np.linalg.norm(away, axis=1) - 0.5).max() < 1.5 * cell
    assert ((away / np.linalg.norm(away, axis=1, keepdims=True)) * normals).sum(axis=1).min() > 0.8


def test_bodies_that_touch_have_one_skin():
    """Of two balls that overlap nothing is left inside."""
    both = np.concatenate([ball(np.array([-0.4, 0, 0]), 0.5), ball(np.array([0.4, 0, 0]), 0.5)])
    points = fused_surface(both, 50, 5000, np.random.default_rng(0))[0]
    inside = np.minimum(*(np.linalg.norm(points - [x, 0, 0], axis=1) for x in (-0.4, 0.4)))
    assert inside.min() > 0.5 - 2 * 1.8 / 50


def test_blocks_have_normals_along_axes():
    points, normals = blocky_surface(ball(np.zeros(3), 1.0), 10, 500, np.random.default_rng(0))
    assert (np.sort(np.abs(normals), axis=1) == [0, 0, 1]).all()
    assert (points * normals).sum(axis=1).min() > -2 / 10  # a block's width


def test_a_plinth_stands_below_its_figure():
    figure = ball(np.array([0, 1.0, 0]), 1.0, 500)
    both = on_plinth(figure, np.random.default_rng(1))
    assert np.array_equal(both[:500], figure) and both[500:, 1].max() <= figure[:, 1].min() + 1e-9


def test_surfaces_of_a_rigged_file_are_read_back(tmp_path):
    folder = tmp_path / "archive"
    folder.mkdir()
    robot = sample_character("robot", rigged=True)
    still = np.broadcast_to(np.eye(3), (5, len(robot.rig.names), 3, 3))
    RigAnimation(robot, still, np.zeros((5, len(robot.rig.names), 3))).save(folder / "robot.glb")
    faces, poses = clip_poses(folder / "robot.glb", "robot", np.random.default_rng(0), 3)
    assert len(poses) == 2 and np.allclose(*poses, atol=1e-4)  # bind pose and a frame of its clip
    points, normals = remade(poses[0], faces, np.random.default_rng(2))
    assert points.shape == normals.shape == (2048, 3) and np.abs(points).max() == pytest.approx(0.5, abs=0.02)
    bank = build_surfaces(folder, tmp_path / "bank.npz", forms=2)
    again = load_surfaces(tmp_path / "bank.npz")
    assert again.names == bank.names == ("robot",) * 4 and np.array_equal(again.points, bank.points)
    assert len(again.those(frozenset({"robot"}), True)) == 4 and not len(again.those(frozenset({"robot"}), False))


def test_what_is_no_bank_is_refused(tmp_path):
    (tmp_path / "bank.npz").write_bytes(b"nothing")
    with pytest.raises(FormatError, match="bunraku data surfaces"):
        load_surfaces(tmp_path / "bank.npz")
