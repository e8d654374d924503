"""Gaits and swings of four-legged bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gaits import gait_of

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import further_limbs
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.generation.features import body_handle_motion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.stages.animals import Gait, Swings
from bunraku.retarget.stages.stage import Fitting
from bunraku_lab.synthetic.samples import make_sample

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


PLAIN = Stages(ground=False, feet=False, smooth=False, floor=False, support=False)


@pytest.fixture(scope="module")
def dog():
    character = make_sample("dog", rigged=True)
    return Anatomy.of(character, rig_handles(character))


def walk_of_four_legs(sizes, frames=80, period=20, hurry=0.0):
    """Arms that point down and legs, swung by so many radians, left and right in turn, ever faster where it hurries."""
    turns = np.zeros((frames, 22, 3))
    cycles = np.arange(frames) / period
    swing = np.sin(2 * np.pi * (cycles + hurry * cycles**2))
    for name, size in sizes.items():
        sign = 1 if name in ("left_shoulder", "right_hip") else -1
        turns[:, JOINT_NAMES.index(name), 0] = sign * size * swing
    rotations = matrix_from_axis_angle(turns)
    for side, sign in (("left", 1), ("right", -1)):
        joint = JOINT_NAMES.index(f"{side}_shoulder")
        rotations[:, joint] = rotations[:, joint] @ matrix_from_axis_angle(np.array([0, 0, -sign * np.pi / 2]))
    body = reference_body()
    return body_handle_motion(
        SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (frames, 1)), 20.0)
    ).of_own_body()


def gaits(motion, dog, stages):
    return gait_of(Animation(dog.character, dog.handles, fit_motion(motion, dog, stages)), dog)


def test_who_limps_walks_evenly_and_as_far_as_in_the_mean(dog):
    limping = walk_of_four_legs({"left_shoulder": 0.5, "right_shoulder": 0.3, "left_hip": 0.3, "right_hip": 0.55})
    before, after = (gaits(limping, dog, stages) for stages in (replace(PLAIN, swings=False), PLAIN))
    assert before[0].ratio > 1.4 and before[1].ratio < 0.7
    for one, other in zip(before, after, strict=True):
        assert 0.93 < other.ratio < 1.07
        assert np.sqrt(other.left * other.right) == pytest.approx(np.sqrt(one.left * one.right), rel=0.08)
        assert other.phase == pytest.approx(one.phase, abs=0.03) == pytest.approx(0.5, abs=0.06)


def test_who_limps_ever_faster_walks_evenly_too(dog):
    limping = walk_of_four_legs(
        {"left_shoulder": 0.5, "right_shoulder": 0.3, "left_hip": 0.3, "right_hip": 0.55}, hurry=0.4
    )
    for pair in gaits(limping, dog, PLAIN):
        assert 0.9 < pair.ratio < 1.1


def test_a_trunk_that_rocks_with_the_steps_makes_no_limp(dog):
    steps = walk_of_four_legs({"left_hip": 0.35, "right_hip": 0.35})
    rocks = matrix_from_axis_angle(np.sin(2 * np.pi * np.arange(80) / 20)[:, None] * [0.1, 0, 0])
    rocking = replace(steps, root_rotation=rocks @ steps.root_rotation)
    before, after = (gaits(rocking, dog, stages)[1] for stages in (replace(PLAIN, swings=False), PLAIN))
    assert before.ratio < 0.8 or before.ratio > 1.25
    assert 0.93 < after.ratio < 1.07


def test_only_what_was_made_for_its_own_kind_on_four_legs_is_touched(dog):
    limping = walk_of_four_legs({"left_hip": 0.3, "right_hip": 0.55})
    assert Swings().applies(Fitting.of(limping, dog), dog)
    assert not Swings().applies(Fitting.of(limping.of_own_body(False), dog), dog)
    body = reference_body()
    person = Anatomy.of(body.character(), body.handles)
    assert not Swings().applies(Fitting.of(limping, person), person)


def test_no_leg_swings_farther_than_those_of_running_animals(dog):
    kicking = walk_of_four_legs(dict.fromkeys(("left_shoulder", "right_shoulder", "left_hip", "right_hip"), 1.1))
    before, after = (gaits(kicking, dog, stages) for stages in (replace(PLAIN, swings=False), PLAIN))
    for one, other in zip(before, after, strict=True):
        assert min(one.left, one.right) > 1.2 * max(other.left, other.right)
