"""The six axes and the 24 right-angle rotations."""

import numpy as np
import pytest

from bunraku.errors import OptionError
from bunraku.geometry.axes import AXES, ORIENTATIONS, axis_name, axis_vector, right_angle_rotations, upright_rotation


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
