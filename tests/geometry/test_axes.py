"""The six axes and the 24 right-angle rotations."""

import numpy as np
import pytest

from bunraku.errors import OptionError
from bunraku.geometry.axes import (
    AXES,
    ORIENTATIONS,
    axis_name,
    axis_vector,
    covered,
    directions_about,
    goes_round,
    right_angle_rotations,
    upright_rotation,
)


def test_the_rotations_are_the_group_of_the_cube():
    rotations = right_angle_rotations()
    assert len(ORIENTATIONS) == len(rotations) == 24
    assert set(np.unique(rotations)) == {-1, 0, 1}
    assert np.array_equal(np.linalg.det(rotations).round(9), np.ones(24))
    keys = {matrix.astype(int).tobytes() for matrix in rotations}
    assert len(keys) == 24 and np.eye(3, dtype=int).tobytes() in keys
    products = np.einsum("aij,bjk->abik", rotations, rotations).reshape(-1, 3, 3)
    assert {matrix.astype(int).tobytes() for matrix in products} == keys
    assert {matrix.T.astype(int).tobytes() for matrix in rotations} == keys


@pytest.mark.parametrize(("up", "front"), ORIENTATIONS)
def test_up_goes_up_and_front_to_the_front(up, front):
    rotation = upright_rotation(up, front)
    assert np.array_equal(rotation @ axis_vector(up), [0, 1, 0]) and np.array_equal(
        rotation @ axis_vector(front), [0, 0, 1]
    )


def test_names():
    assert [axis_name(text) for text in ("z", "+Z", " -y ", "X")] == ["+z", "+z", "-y", "+x"]
    assert all(axis_name(name) == name for name in AXES)
    for text in ("w", "", "xy", "--x", "+"):
        with pytest.raises(OptionError, match="is no axis"):
            axis_name(text)
    with pytest.raises(OptionError, match="right angle"):
        upright_rotation("+y", "-y")


def test_a_ring_covers_all_and_a_half_covers_half():
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False) + 0.01
    ring = np.stack([np.linspace(0, 1, 240), 0.2 * np.cos(angle), 0.2 * np.sin(angle)], axis=1)
    found = directions_about(ring, np.zeros(3), np.array([3.0, 0, 0]))
    assert covered(found) == 1
    assert goes_round(found) and not goes_round(found[:120])
    assert covered(found[:120]) == pytest.approx(0.5, abs=0.1)
    # a step about the line is a step of the direction, whichever way it counts
    steps = np.angle(np.exp(1j * np.diff(found)))
    np.testing.assert_allclose(np.abs(steps), 2 * np.pi / 240, rtol=1e-4)


def test_what_lies_beside_a_line_covers_little():
    points = np.random.default_rng(0).normal([0, 5, 0], 0.1, (50, 3))
    assert covered(directions_about(points, np.zeros(3), np.array([1.0, 0, 0]))) <= 2 / 12
