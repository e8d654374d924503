"""Shear and gaps of two boxes whose motion is written by hand."""

import numpy as np
import trimesh

from bunraku.core.character import Character
from bunraku_lab.evaluation.handles.rigid_blocks import block_motion


def boxes():
    """Two unit boxes that touch at x = 0.5, as one character."""
    one, two = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    two.apply_translation((1, 0, 0))
    both = trimesh.util.concatenate([one, two])
    label = np.repeat([0, 1], len(one.vertices))
    return Character("boxes", both.vertices, both.faces), label


def test_a_gap_is_how_far_blocks_come_apart():
    character, label = boxes()
    posed = np.tile(character.vertices, (3, 1, 1)).astype(np.float64)
    posed[1, label == 1] += [0.07, 0, 0]
    posed[2, label == 1] -= [0.03, 0, 0]  # sinks in
    found = block_motion(character, label, [(1, 0)], posed)
    np.testing.assert_allclose(found.gaps, [0.07], atol=0.006)
    assert found.shear < 1e-6


def test_a_turn_about_the_contact_opens_nothing_and_a_bend_is_shear():
    character, label = boxes()
    posed = np.tile(character.vertices, (2, 1, 1)).astype(np.float64)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pivot = np.array([0.5, 0, 0])
    posed[1, label == 1] = (posed[1, label == 1] - pivot) @ turn.T + pivot
    found = block_motion(character, label, [(1, 0)], posed)
    assert found.gaps[0] < 0.006
    assert found.shear < 1e-6
    posed[1, 0] += [0, 0.1, 0]
    assert 0.04 < block_motion(character, label, [(1, 0)], posed).shear < 0.1
