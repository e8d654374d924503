"""Edges against lengths worked out by hand."""

import numpy as np
import pytest

from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.handles.stretch import edge_error, edge_stretch, stretch_of


def test_an_edge_s_largest_length_over_its_own():
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
    posed = np.stack([rest, rest * [3, 1, 1], rest * [1, 0.5, 1]])
    np.testing.assert_allclose(edge_stretch(rest, posed, np.array([[0, 1], [0, 2]])), [3, 1])


def test_two_edges_of_three_are_stretched():
    """One vertex of a triangle is carried off along its edge to the next; the third one stays at a right angle."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    weights = np.zeros((3, 2), np.float32)
    weights[[0, 2], 0], weights[1, 1] = 1, 1
    character = Character("triangle", vertices, np.array([[0, 1, 2]]))
    handles = Handles(vertices[:2], weights)
    shift = np.zeros((7, 2, 3))
    shift[6, 1, 0] = 4.0
    turns = np.tile(np.eye(3), (7, 2, 1, 1))
    found = stretch_of(character, handles, HandleMotion(shift, turns, np.zeros((7, 3)), turns[:, 0]))
    assert found["most_stretched"] == pytest.approx(5)
    assert found["stretched_edges"] == pytest.approx(
        2 / 3
    )  # the other edge of the vertex is sqrt(26 / 2) times as long
    still = stretch_of(character, handles, HandleMotion(0 * shift, turns, np.zeros((7, 3)), turns[:, 0]))
    assert still == {"stretched_edges": 0.0, "most_stretched": 1.0}


def test_the_edge_error_is_the_mean_change_of_length():
    """One vertex of a triangle is shifted by its edge's length in one of two frames that are looked at."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    weights = np.array([[1, 0], [0, 1], [1, 0]], np.float32)
    character = Character("triangle", vertices, np.array([[0, 1, 2]]))
    shift = np.zeros((4, 2, 3))
    shift[3, 1, 0] = 1.0
    turns = np.tile(np.eye(3), (4, 2, 1, 1))
    motion = HandleMotion(shift, turns, np.zeros((4, 3)), turns[:, 0])
    changes = np.array([[0, 0, 0], [1, 0, np.sqrt(5 / 2) - 1]])
    assert edge_error(character, Handles(vertices[:2], weights), motion) == pytest.approx(changes.mean(), rel=1e-5)
