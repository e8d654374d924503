import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.datasets.motions.hinges import rolled_limbs, unrolled

J = {name: index for index, name in enumerate(JOINT_NAMES)}


def squats(rolled: bool) -> SkeletalMotion:
    """Someone whose knees bend up to 90 degrees; the right leg's bones may be rolled by half a turn about
    themselves.
    """
    bend = np.deg2rad(90) * np.sin(np.linspace(0, np.pi, 40))
    rotations = np.tile(np.eye(3), (40, len(JOINT_NAMES), 1, 1))
    for side in ("left", "right"):
        rotations[:, J[f"{side}_hip"]] = matrix_from_axis_angle(np.stack([-0.5 * bend, 0 * bend, 0 * bend], axis=1))
        rotations[:, J[f"{side}_knee"]] = matrix_from_axis_angle(np.stack([bend, 0 * bend, 0 * bend], axis=1))
    if rolled:
        down = reference_body().skeleton.offsets[J["right_ankle"]]
        down = down / np.linalg.norm(down)
        half = 2 * np.outer(down, down) - np.eye(3)  # about the shin
        rotations[:, J["right_hip"]] = rotations[:, J["right_hip"]] @ half
        rotations[:, J["right_knee"]] = half @ rotations[:, J["right_knee"]] @ half
    return SkeletalMotion(reference_body().skeleton, rotations, np.zeros((40, 3)), 20.0)


def test_a_rolled_leg_is_found_and_only_that():
    assert rolled_limbs(squats(False)) == []
    assert rolled_limbs(squats(True)) == ["right_knee"]


def test_places_stay_and_the_knee_bends_back():
    before = squats(True)
    after = unrolled(before)
    np.testing.assert_allclose(after.world()[1], before.world()[1], atol=1e-5)
    assert rolled_limbs(after) == []


def test_a_sound_motion_is_the_same_object():
    sound = squats(False)
    assert unrolled(sound) is sound
