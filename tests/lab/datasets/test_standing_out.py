import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.datasets.apparel.standing_out import standing_out


def skirt() -> ClothedCharacter:
    """Ten vertices around the knees that hang from the pelvis, at 1 m."""
    angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rest = np.stack([0.3 * np.cos(angle), np.full(10, 0.5), 0.3 * np.sin(angle)], axis=1).astype(np.float32)
    weights = np.zeros((10, JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    joints = np.zeros((JOINT_COUNT, 3), np.float32)
    joints[0, 1], joints[-1, 1] = 1.0, 1.7
    none = np.zeros(1, np.float32)
    faces = np.array([[0, 1, 2]])
    return ClothedCharacter(rest, faces, joints, weights, np.ones(10, bool), np.zeros(10, np.int64), none, none)


def poses(raised: slice) -> np.ndarray:
    out = np.zeros((90, JOINT_COUNT, 3, 4), np.float32)
    out[..., :3] = np.eye(3)
    out[raised, JOINT_NAMES.index("left_hip"), :, :3] = matrix_from_axis_angle(np.array([-1.2, 0, 0]))
    return out


def test_a_hem_that_stays_up_after_the_leg_came_down_stands_out_and_one_on_the_leg_does_not():
    clothed, loose = skirt(), np.arange(10)
    up = np.zeros((90, 10, 3))
    up[:, :3, 1] = 0.06 * clothed.scale + 0.01
    transforms = poses(slice(10, 30))
    calm_and_settled = 90 - 30 - 15
    assert standing_out(clothed, transforms, loose, up) == 1.0
    falls = up.copy()
    falls[30 + 15 + 9 :] = 0  # it hangs for nine of the frames that count, and is moving when it falls
    found = standing_out(clothed, transforms, loose, falls)
    assert 7 / calm_and_settled <= found <= 9 / calm_and_settled
    assert standing_out(clothed, poses(slice(0, 90)), loose, up) == 0.0
    assert standing_out(clothed, transforms, loose, 0 * up) == 0.0


def test_what_swings_does_not_stand_out():
    clothed = skirt()
    swing = np.zeros((90, 10, 3))
    swing[..., 1] = 0.2 + 0.1 * np.sin(np.arange(90) * 0.5)[:, None]  # 1.5 m/s
    assert standing_out(clothed, poses(slice(0, 0)), np.arange(10), swing) < 0.2
