"""Directions about a line, and how many of them are covered."""

import numpy as np
import pytest

from bunraku.geometry.directions import covered, directions_about


def test_a_ring_covers_all_and_a_half_covers_half():
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False) + 0.01
    ring = np.stack([np.linspace(0, 1, 240), 0.2 * np.cos(angle), 0.2 * np.sin(angle)], axis=1)
    found = directions_about(ring, np.zeros(3), np.array([3.0, 0, 0]))
    assert covered(found) == 1
    assert covered(found[:120]) == pytest.approx(0.5, abs=0.1)
    # a step about the line is a step of the direction, whichever way it counts
    steps = np.angle(np.exp(1j * np.diff(found)))
    np.testing.assert_allclose(np.abs(steps), 2 * np.pi / 240, rtol=1e-4)


def test_what_lies_beside_a_line_covers_little():
    points = np.random.default_rng(0).normal([0, 5, 0], 0.1, (50, 3))
    assert covered(directions_about(points, np.zeros(3), np.array([1.0, 0, 0]))) <= 2 / 12
