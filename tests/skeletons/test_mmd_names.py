"""MMD's standard bones as SMPL's joints."""

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.core.motion import Skeleton
from bunraku.skeletons.bone_words import plain_name
from bunraku.skeletons.mmd_names import mmd_skeleton_map
from bunraku.skeletons.skeleton_map import map_skeleton

BODY = ["全ての親", "センター", "グルーブ", "腰", "上半身", "上半身2", "首", "頭", "下半身"]
LIMBS = [
    side + part
    for side in "左右"
    for part in ["肩", "腕", "腕捩", "ひじ", "手首", "足", "ひざ", "足首", "つま先", "足ＩＫ"]
]


def joints(names):
    found = mmd_skeleton_map(names)
    return {joint: names[index] for joint, index in zip(JOINT_NAMES, found.joints, strict=True) if index >= 0}


def test_standard_bones():
    found = joints(BODY + LIMBS)
    assert (
        found["pelvis"] == "下半身"
        and found["spine1"] == "上半身"
        and found["spine3"] == "上半身2"
        and "spine2" not in found
    )
    assert (
        found["left_collar"] == "左肩"
        and found["right_elbow"] == "右ひじ"
        and found["left_hip"] == "左足"
        and found["right_foot"] == "右つま先"
    )
    assert joints([*BODY, "上半身３", *LIMBS, "左足先EX"])["spine3"] == "上半身３"  # wide digits are the same
    assert joints([*BODY, *LIMBS, "左足先ＥＸ"])["left_foot"] == "左足先ＥＸ"
    assert joints([name for name in BODY if name != "下半身"] + LIMBS)["pelvis"] == "腰"
    assert plain_name("左足ＩＫ２") == "左足IK2"


def test_other_names_are_not_theirs():
    assert mmd_skeleton_map(["Hips", "LeftLeg"]) is None
    assert mmd_skeleton_map([name for name in BODY + LIMBS if name != "左ひざ"]) is None


def test_skeletons_of_any_file_with_these_names_are_mapped():
    names = ("センター", "上半身", "首", "頭", "下半身", "左足", "左ひざ", "右足", "右ひざ", "左腕", "右腕")
    parents = np.array([-1, 0, 1, 2, 0, 4, 5, 4, 7, 1, 1])
    found = map_skeleton(Skeleton(names, parents, np.zeros((len(names), 3))))
    assert (
        found.convention == "MikuMikuDance"
        and found.of("pelvis") == 4
        and found.of("neck") == 2
        and found.of("left_shoulder") == 9
    )
