"""Fins and forelegs that a generator knows nothing of: a body of one fin a side, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.anatomy.joints import Joints
from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.character import Handles
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.retarget.stages.fins import Fins

FPS, FRAMES = 20.0, 80
CHEST, ARM, HAND = (HANDLE_NAMES.index(name) for name in ("spine3", "left_shoulder", "left_elbow"))


@pytest.fixture
def fish() -> tuple[Handles, Joints]:
    positions = np.zeros((30, 3))
    return Handles(positions, np.full((4, 30), 1 / 30)), Joints(positions, np.array(HANDLE_PARENTS), np.ones(30, bool))


def turned(arm: np.ndarray, trunk: float = 0.3) -> np.ndarray:
    """The whole body turned about +Y, and both parts of the left arm hanging by an angle each frame [rad]."""
    rotations = np.tile(matrix_from_axis_angle(np.array([0, trunk, 0])), (FRAMES, 30, 1, 1))
    hangs = matrix_from_axis_angle(-arm[:, None] * np.array([0, 0, 1.0]))
    for part in (ARM, HAND, *(HANDLE_NAMES.index(f"left_{name}") for name in ("wrist", "fingers"))):
        rotations[:, part] = rotations[:, part] @ hangs
    return rotations


def off_the_trunk(rotations: np.ndarray, part: int = ARM) -> np.ndarray:
    """How far a part is turned against the chest in each frame [rad]."""
    between = rotations[:, CHEST].transpose(0, 2, 1) @ rotations[:, part]
    return -np.asarray(axis_angle_from_matrix(between))[:, 2]


def test_arms_that_go_with_the_trunk_were_not_drawn():
    assert not Fins().drawn(turned(np.full(FRAMES, np.radians(4))))
    assert Fins().drawn(turned(np.full(FRAMES, np.radians(60))))


def test_fins_that_were_not_drawn_rest(fish):
    found = Fins().held(turned(np.full(FRAMES, 1.2)), *fish, False, FPS)
    np.testing.assert_allclose(off_the_trunk(found), 0, atol=1e-6)
    np.testing.assert_allclose(off_the_trunk(found, HAND), 0, atol=1e-6)


def test_fins_are_held_near_their_rest_and_beat(fish):
    beat = 0.3 * np.sin(2 * np.pi * 2 * np.arange(FRAMES) / FPS)
    found = off_the_trunk(Fins().held(turned(1.2 + beat), *fish, True, FPS))
    assert found[20:60].mean() == pytest.approx(Fins().aside, abs=0.03)
    assert np.ptp(found[20:60]) == pytest.approx(0.6, rel=0.1)


def test_fins_near_their_rest_are_left_alone(fish):
    rotations = turned(0.1 * np.sin(np.arange(FRAMES) / 3))
    np.testing.assert_allclose(Fins().held(rotations, *fish, True, FPS), rotations, atol=1e-6)
