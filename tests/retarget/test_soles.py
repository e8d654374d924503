"""Long feet are held flatter where they would sink; feet of a person's size stay bit for bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import foot_points
from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.stages.soles import Soles

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
FRAMES, MIDDLE = 41, 20


def footed(longer: float) -> Anatomy:
    """The reference body with feet that reach so many times as far from their ankles."""
    body = reference_body()
    vertices = body.vertices.astype(np.float64).copy()
    for side in ("left", "right"):
        foot = body.handle_weights[:, [H[f"{side}_ankle"], H[f"{side}_foot"]]].sum(axis=1) > 0.5
        ankle = body.joints[H[f"{side}_ankle"]]
        vertices[foot, 2] = ankle[2] + longer * (vertices[foot, 2] - ankle[2])
    character = Character("footed", vertices, body.faces)
    weights = body.handle_weights
    return Anatomy.of(character, Handles(handle_positions(vertices, weights, character.areas), weights))


def tiptoeing() -> HandleMotion:
    """Both feet point down by 35 degrees in the middle, while the body is as high as a person's toes need."""
    angle = np.radians(35) * np.exp(-(((np.arange(FRAMES) - MIDDLE) / 4.0) ** 2))
    rotations = np.tile(np.eye(3), (FRAMES, HANDLE_COUNT, 1, 1))
    for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"):
        rotations[:, H[name]] = matrix_from_axis_angle(angle[:, None] * np.array([1.0, 0, 0]))
    path = np.zeros((FRAMES, 3))
    path[:, 1] = 0.18 * np.sin(angle)
    return HandleMotion(
        np.zeros((FRAMES, HANDLE_COUNT, 3)), rotations, path, np.tile(np.eye(3), (FRAMES, 1, 1)), own_height=True
    )


def slopes(motion: HandleMotion) -> np.ndarray:
    """How far the left foot points down in each frame [degrees]."""
    return np.degrees(np.arcsin(np.clip(-motion.rotations[:, H["left_ankle"], 1, 2], -1, 1)))


def test_long_feet_are_held_flatter_and_do_not_sink():
    anatomy = footed(2.5)
    off = fit_motion(tiptoeing(), anatomy, replace(Stages(), soles=False, feet=False, floor=False))
    on = Soles().flatter(off, anatomy)
    assert slopes(off)[MIDDLE] == pytest.approx(35, abs=3)
    assert slopes(on)[MIDDLE] < 22
    leg = anatomy.legs[0]
    for motion, sunk in ((off, True), (on, False)):
        world = motion.transforms(anatomy.handles.positions)
        low = foot_points(leg, anatomy.mesh, anatomy.mesh_handles, world)[..., 1].min() - anatomy.floor
        assert (low < -1.05 * Soles().sinks * leg.length) == sunk
    np.testing.assert_array_equal(on.root_translation, off.root_translation)


def test_a_persons_feet_stay_bit_for_bit():
    anatomy = footed(1.0)
    fitted = fit_motion(tiptoeing(), anatomy, replace(Stages(), soles=False, feet=False, floor=False))
    assert Soles().flatter(fitted, anatomy) is fitted
