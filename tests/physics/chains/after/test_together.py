"""Neighbours turn alike, and a skirt keeps its sag."""

import numpy as np

from bunraku.core.character import Character, Rig
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.physics.chains.after.together import together
from bunraku.physics.chains.chain import Chain, laid_manner

COLUMNS, FRAMES = 8, 3


def skirt():
    """Columns of one link all round, each on a bone of its own beneath a root, and which are neighbours."""
    turn = np.linspace(0, 2 * np.pi, COLUMNS, endpoint=False)
    out = np.stack([np.sin(turn), np.zeros(COLUMNS), np.cos(turn)], axis=1)
    transforms = np.tile(np.eye(4), (COLUMNS + 1, 1, 1))
    transforms[1:, :3, 3] = 0.2 * out + [0, 1, 0]
    names = ("root", *(f"skirt_0_{column}" for column in range(COLUMNS)))
    points = np.concatenate([[[0, 1, 0]], 0.3 * out + [0, 0.5, 0]])
    indices = np.zeros((len(points), 4), np.int32)
    indices[:, 0] = np.arange(len(points))
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1))
    rig = Rig(names, np.array([-1, *[0] * COLUMNS]), transforms, indices, weights)
    faces = np.array([[0, one, one % COLUMNS + 1] for one in range(1, COLUMNS + 1)])
    chains = [
        Chain(
            name, "skirt", np.array([column + 1]), np.stack([0.2 * way + [0, 1, 0], 0.3 * way + [0, 0.5, 0]]), 0,
            np.full(1, 0.05), 0.01, laid_manner("skirt", 0.5),
        )
        for column, (name, way) in enumerate(zip(names[1:], out, strict=True))
    ]  # fmt: skip
    near = [(column, (column + 1) % COLUMNS, 0.5) for column in range(COLUMNS)]
    return Character("skirt", points.astype(np.float32), faces, rig), chains, near, out


def turned(angles):
    """The animation whose columns turn outwards by angles [rad], shape (COLUMNS,), and what comes of it together."""
    character, chains, near, out = skirt()
    axes = np.cross([0.0, -1.0, 0.0], out)
    rotations = np.tile(np.eye(3), (FRAMES, COLUMNS + 1, 1, 1))
    rotations[:, 1:] = matrix_from_axis_angle(angles[:, None] * axes)
    given = RigAnimation(character, rotations, np.zeros((FRAMES, COLUMNS + 1, 3)))
    found = axis_angle_from_matrix(together(given, chains, near).rotations[:, 1:].astype(float))
    return (found * axes).sum(axis=-1), np.linalg.norm(found, axis=-1)


def test_a_skirt_that_sags_all_round_stays_so():
    angle, whole = turned(np.full(COLUMNS, -0.3))
    np.testing.assert_allclose(angle, -0.3, atol=1e-5)
    np.testing.assert_allclose(whole, 0.3, atol=1e-5)


def test_a_column_that_goes_its_own_way_is_drawn_back_by_its_neighbours():
    angles = np.zeros(COLUMNS)
    angles[2] = 0.8
    angle, _ = turned(angles)
    assert (angle[:, 2] < 0.5).all() and (angle[:, 2] > 0.1).all()
    assert (angle[:, [1, 3]] > 0.05).all()
    assert (np.abs(angle[:, 6]) < 0.15).all()
