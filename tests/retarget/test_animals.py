"""Gaits of bodies with further legs."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.anatomy.joints import further_limbs
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.animals import Gait

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
FPS = 20.0
SPARE = {"left": ("left_wing", "left_fingers"), "right": ("right_wing", "right_fingers")}


def legs(count: int) -> Handles:
    """A body with so many legs a side of one handle each, from the back to the front half a metre apart."""
    body = reference_body()
    weights = np.zeros((2 * count + 1, len(HANDLE_NAMES)), np.float32)
    weights[-1, 0] = 1
    positions = np.array(body.handles.positions)
    roles = np.arange(len(HANDLE_NAMES))
    for s, side in enumerate(("left", "right")):
        for number, name in enumerate((f"{side}_hip", *SPARE[side])[:count]):
            weights[s * count + number, H[name]] = 1
            positions[H[name]] = [0.2 - 0.4 * s, 0.5, 0.5 * number]
            roles[H[name]] = H[f"{side}_hip"]
    return Handles(positions, weights, roles=roles)


def walk(cycle: float, frames: int = 120, both: float = 0.0) -> HandleMotion:
    """Hips that swing against one another, or, by `both`, together."""
    angles = np.zeros((frames, len(HANDLE_NAMES), 3))
    swing = 0.5 * np.sin(2 * np.pi * np.arange(frames) / FPS / cycle)
    angles[:, H["left_hip"], 0] = (1 - both) * swing + both * swing
    angles[:, H["right_hip"], 0] = (both - 1) * swing + both * swing
    still = np.zeros((frames, len(HANDLE_NAMES), 3))
    return HandleMotion(
        still, matrix_from_axis_angle(angles), np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)), FPS
    )


@pytest.mark.parametrize("cycle", [0.6, 1.0, 2.0])
def test_the_cycle_is_that_of_left_against_right(cycle):
    assert Gait().cycle(walk(cycle)) == pytest.approx(cycle, abs=0.5 / FPS)
    assert Gait().cycle(walk(cycle, both=1.0)) == 0  # a hop is no step
    assert Gait().cycle(walk(1.0, frames=4)) == 0


def test_six_legs_stand_on_tripods_and_slow_ones_lift_one_after_the_other():
    fast, slow = (
        Gait().phases(legs(3), further_limbs(legs(3)), 0.8),
        Gait().phases(legs(3), further_limbs(legs(3)), 2.0),
    )
    assert [fast[H[name]] for name in SPARE["left"]] == [0.5, 0.0]
    assert [slow[H[name]] for name in SPARE["right"]] == pytest.approx([1 / 3, 2 / 3])


def test_a_further_leg_is_half_a_cycle_behind():
    handles, motion = legs(2), walk(1.0)
    turned = axis_angle_from_matrix(Gait().stepping(motion, handles, further_limbs(handles)))[..., 0]
    first, second = turned[:, H["left_hip"]], turned[:, H["left_wing"]]
    assert second == pytest.approx(-first, abs=0.02)  # of a sine, half a cycle later
    assert turned[:, H["right_wing"]] == pytest.approx(first, abs=0.02)


def test_what_is_done_together_stays_so():
    handles, motion = legs(2), walk(1.0, both=1.0)
    turned = Gait().stepping(motion, handles, further_limbs(handles))
    assert np.array_equal(turned[:, H["left_wing"]], turned[:, H["left_hip"]])
    plain = Handles(handles.positions, handles.weights)
    assert np.array_equal(
        Gait().stepping(walk(1.0), plain, further_limbs(plain)), walk(1.0).rotations.astype(np.float64)
    )
