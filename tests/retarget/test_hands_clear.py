"""Hands that sink into the body come out of it, and all else stays as it is to the bit."""

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.body_motion import body_handle_motion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.stages.hands_clear import BodySurface, HandsClear
from bunraku_lab.evaluation.motion.viewer.look import hands_in_body

WITHOUT = Stages(ground=False, feet=False, smooth=False, floor=False, hands_clear=False)
WITH = Stages(ground=False, feet=False, smooth=False, floor=False)


@pytest.fixture(scope="module")
def anatomy():
    body = reference_body()
    return Anatomy.of(body.character(), body.handles)


def bent(elbow, frames=48):
    """Arms down, forearms bent inwards [rad] from one end of the clip to the other and back."""
    turns = np.zeros((frames, 22, 3))
    share = np.sin(np.linspace(0, np.pi, frames))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, JOINT_NAMES.index(f"{side}_shoulder"), 2] = -sign * 1.2
        turns[:, JOINT_NAMES.index(f"{side}_elbow"), 2] = -sign * elbow * share
    body = reference_body()
    return body_handle_motion(
        SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), 20.0)
    )


def test_hands_in_the_hips_come_out_of_them(anatomy):
    motion = bent(0.65).of_own_body()
    before, after = (fit_motion(motion, anatomy, stages) for stages in (WITHOUT, WITH))
    assert hands_in_body(before, 1).mean() > 0.2
    assert not hands_in_body(after, 1).any()
    step = np.linalg.norm(np.diff(after.transforms(anatomy.handles.positions)[:, 20, :, 3], axis=0), axis=1)
    usual = np.linalg.norm(np.diff(before.transforms(anatomy.handles.positions)[:, 20, :, 3], axis=0), axis=1)
    assert step.max() < 2 * usual.max()  # without a jump


def test_hands_that_are_outside_stay(anatomy):
    motion = bent(0.3).of_own_body()
    before, after = (fit_motion(motion, anatomy, stages) for stages in (WITHOUT, WITH))
    np.testing.assert_array_equal(before.rotations, after.rotations)


def test_motions_that_were_not_generated_stay(anatomy):
    motion = bent(0.65)
    before, after = (fit_motion(motion, anatomy, stages) for stages in (WITHOUT, WITH))
    np.testing.assert_array_equal(before.rotations, after.rotations)


def test_depths_are_those_of_looking_at_every_part(anatomy):
    motion = bent(1.2).of_own_body()
    stage, surface = HandsClear(), BodySurface(anatomy)
    hands = stage.hand(motion, anatomy.arms[0], anatomy)
    found, out = surface.depths(motion, hands, 0.15)
    world = motion.transforms(anatomy.handles.positions).astype(float)
    for frame in range(0, len(motion), 7):
        for point in range(0, hands.shape[1], 11):
            best, depth = 0.15, -np.inf
            for part in surface._parts:
                local = world[frame, part.handle, :, :3].T @ (hands[frame, point] - world[frame, part.handle, :, 3])
                away = np.linalg.norm(part.points - local, axis=1)
                if away.min() < best:
                    nearest = int(away.argmin())
                    best, depth = away[nearest], (part.points[nearest] - local) @ part.normals[nearest]
            assert found[frame, point] == pytest.approx(depth, abs=1e-9)
            assert np.isinf(depth) or np.linalg.norm(out[frame, point]) == pytest.approx(1, abs=1e-5)
