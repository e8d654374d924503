import numpy as np
import pytest

from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.skeletons.rig_axes import rig_axes


@pytest.mark.parametrize(("up", "front"), ORIENTATIONS)
def test_the_reference_skeleton_is_recognised_however_it_lies(up, front):
    lying = reference_body().joints @ upright_rotation(up, front)  # the inverse turn of what would stand it up
    assert rig_axes(JOINT_NAMES, JOINT_PARENTS, lying) == (up, front)


def test_what_leaves_a_doubt_is_none():
    joints = reference_body().joints
    assert rig_axes([f"Bone.{n}" for n in range(22)], JOINT_PARENTS, joints) is None
    turn = np.deg2rad(40)
    between = joints @ np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    assert rig_axes(JOINT_NAMES, JOINT_PARENTS, between) is None
    assert rig_axes(JOINT_NAMES[:1], [-1], joints[:1]) is None
