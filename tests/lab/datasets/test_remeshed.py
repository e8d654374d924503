"""Surfaces remade by voxels, held against bodies whose surfaces are known."""

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError
from bunraku.geometry.rotations import matrix_from_axis_angle, matrix_y
from bunraku_lab.datasets.characters.remeshed import blocky_surface, filled_cells, fused_surface, on_plinth
from bunraku_lab.datasets.characters.surfaces import build_surfaces, clip_poses, load_surfaces, remade
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.datasets.motions.posed_people import clips_of_people, posed_people
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.wardrobe.character import wardrobe_character


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
    both, area = on_plinth(figure, 4 * np.pi, np.random.default_rng(1))
    assert np.array_equal(both[:500], figure) and both[500:, 1].max() <= figure[:, 1].min() + 1e-9
    assert len(both) / area == pytest.approx(500 / (4 * np.pi), rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_a_thick_figure_on_a_plinth_has_no_surface_inside(seed):
    """At the most voxels that leave no gap, nothing is deeper than two of them in the ball or in its plinth."""
    rng = np.random.default_rng(seed)
    both, area = on_plinth(ball(np.array([0, 1.0, 0]), 1.0, 60_000), 4 * np.pi, rng)
    cells = filled_cells(both, area)
    size = np.ptp(both, axis=0).max() / cells
    points = fused_surface(both, cells, 20_000, rng)[0]
    assert 20 < cells < 80
    assert np.linalg.norm(points - [0, 1, 0], axis=1).min() > 1 - 2 * size
    low, high = both[60_000:].min(axis=0), both[60_000:].max(axis=0)
    reach = np.minimum(points - low, high - points).min(axis=1)
    beside = np.linalg.norm(points[:, [0, 2]], axis=1) > 0.2  # under the ball its foot is let in
    across = np.linalg.norm(both[60_000:][:, [0, 2]], axis=1).max() / high[0]
    assert across < 1.2 or reach[beside].max() < 2 * size  # of a box; a disc's corners are not its own


def test_surfaces_of_a_rigged_file_are_read_back(tmp_path):
    folder = tmp_path / "archive"
    folder.mkdir()
    robot = make_sample("robot", rigged=True)
    still = np.broadcast_to(np.eye(3), (5, len(robot.rig.names), 3, 3))
    RigAnimation(robot, still, np.zeros((5, len(robot.rig.names), 3))).save(folder / "robot.glb")
    faces, poses = clip_poses(folder / "robot.glb", "robot", np.random.default_rng(0), 3)
    assert len(poses) == 2 and np.allclose(*poses, atol=1e-4)  # bind pose and a frame of its clip
    points, normals = remade(poses[0], faces, np.random.default_rng(2))
    assert points.shape == normals.shape == (2048, 3) and np.abs(points).max() == pytest.approx(0.5, abs=0.02)
    cast = build_surfaces(folder, tmp_path / "cast.npz", 0, 1, people=2, person=lambda number: (faces, poses))
    assert cast.names == ("robot", "people/0", "people/0", "people/1", "people/1")
    bank = build_surfaces(folder, tmp_path / "bank.npz", forms=2)
    again = load_surfaces(tmp_path / "bank.npz")
    assert again.names == bank.names == ("robot",) * 4 and np.array_equal(again.points, bank.points)
    assert len(again.those(frozenset({"robot"}), True)) == 4 and not len(again.those(frozenset({"robot"}), False))


def test_people_in_captured_poses_stand_and_face_ahead(tmp_path):
    """A person whose clip heads to +X and bows in its last frames: the bows are left out, the heading is taken off."""
    body = np.tile(matrix_y(np.array(np.pi / 2)), (40, 1, 1))
    body[20:] = body[20:] @ matrix_from_axis_angle(np.array([np.radians(80), 0, 0]))
    count = len(HANDLE_NAMES)
    still = np.zeros((40, count, 3)), np.tile(np.eye(3), (40, count, 1, 1))
    write_clip(tmp_path / "turn.npz", HandleMotion(*still, np.zeros((40, 3)), body, 20.0))
    write_index(tmp_path, {"turn": {"texts": ["a person bows"]}, "neigh": {"species": "horse"}})
    clips = clips_of_people(tmp_path)
    assert [clip.name for clip in clips] == ["turn.npz"]
    faces, found = posed_people(3, clips, 24)
    assert 4 < len(found) < 24 and faces.max() < len(found[0])
    person = wardrobe_character(3)
    toes = person.vertices[:, 1] < person.vertices[:, 1].min() + 0.03 * person.height
    ankles = np.abs(person.vertices[:, 1] - 0.08 * person.height) < 0.02 * person.height
    for vertices in found:
        ahead = vertices[toes].mean(axis=0) - vertices[ankles].mean(axis=0)
        assert np.ptp(vertices[:, 1]) > 0.8 * person.height and ahead[2] > 2 * abs(ahead[0])


def test_what_is_no_bank_is_refused(tmp_path):
    (tmp_path / "bank.npz").write_bytes(b"nothing")
    with pytest.raises(FormatError, match="bunraku data surfaces"):
        load_surfaces(tmp_path / "bank.npz")
