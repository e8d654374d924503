"""How far a body is off its ground: exact on a box that is carried."""

import numpy as np
import pytest

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.transfer.ground import ground_heights, off_ground

FPS = 20.0


def carried(heights: np.ndarray) -> Animation:
    """A tetrahedron of height 2 that stands at y = 1 and is lifted by so much [m]."""
    points = np.array([[0, 1, 0], [1, 1, 0], [0, 1, 1], [0, 3, 0], [0, -9, 0]], np.float32)  # the last has no face
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    count = len(heights)
    path = np.zeros((count, 3))
    path[:, 1] = heights
    motion = HandleMotion(
        np.zeros((count, 1, 3)), np.tile(np.eye(3), (count, 1, 1, 1)), path, np.tile(np.eye(3), (count, 1, 1)), FPS
    )
    return Animation(Character("box", points, faces), Handles(np.zeros((1, 3)), np.ones((5, 1))), motion)


def test_heights_are_over_the_ground_that_the_body_rests_on():
    lifts = np.array([0.0, 0.2, -0.1])
    np.testing.assert_allclose(ground_heights(carried(lifts)), lifts / 2, atol=1e-6)


@pytest.mark.parametrize(("frames", "expected"), [(8, 0.0), (30, 0.4)])
def test_a_leap_is_not_off_the_ground_and_hovering_is(frames, expected):
    heights = np.zeros(60)
    heights[10 : 10 + frames] = 0.4
    assert off_ground(heights, FPS) == pytest.approx(expected)


def test_sinking_counts_however_short():
    heights = np.zeros(40)
    heights[7] = -0.03
    assert off_ground(heights, FPS) == pytest.approx(0.03)
