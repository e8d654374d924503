"""Names of bones, in any convention, and skeletons mapped by names and structure."""

import time

import numpy as np
import pytest
from bvh_files import ALONG_X, CMU, DIALECTS, bvh_text
from motion_files import walk_about
from scipy.spatial.transform import Rotation

from bunraku.anatomy.names.bone_names import handle_of_joints, limb_parents, resolve_joints, rig_axes
from bunraku.anatomy.names.bone_words import (
    APPAREL_KINDS,
    apparel_of_name,
    left_axis,
    part_of_name,
    plain_name,
    without_prefix,
)
from bunraku.anatomy.names.skeleton_map import joints_by_structure, map_skeleton, mmd_skeleton_map
from bunraku.anatomy.names.to_smpl import rest_is_a_pose, to_smpl
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import MotionError
from bunraku.pipelines.to_reference import load_motion

# ruff: noqa: E501 - rigs read best on one line


def rig(text: str) -> tuple[list[str], list[int]]:
    """Names and parents from `A B C<A`: the parent is the bone before unless given; `X<-` has none."""
    names, parents = [], []
    for entry in text.split():
        name, _, parent = entry.partition("<")
        parents.append(-1 if parent == "-" or not names else names.index(parent) if parent else len(names) - 1)
        names.append(name)
    return names, parents


def read(text: str, **options) -> dict[str, str]:
    names, parents = rig(text)
    return {
        n: HANDLE_NAMES[h] if h >= 0 else ""
        for n, h in zip(names, handle_of_joints(names, parents, **options), strict=True)
    }


def check(found: dict[str, str], expected: str) -> None:
    for entry in expected.split():
        bone, _, handle = entry.partition("=")
        assert found[bone] == handle, f"{bone} is {found[bone]!r}, not {handle!r}"


def test_mixamo():
    found = read(
        "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head mixamorig:HeadTop_End "
        "mixamorig:LeftShoulder<mixamorig:Spine2 mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand mixamorig:LeftHandThumb1 "
        "mixamorig:RightUpLeg<mixamorig:Hips mixamorig:RightLeg mixamorig:RightFoot mixamorig:RightToeBase mixamorig:RightToe_End"
    )
    check(
        {k.removeprefix("mixamorig:"): v for k, v in found.items()},
        "Hips=pelvis Spine=spine1 Spine1=spine2 Spine2=spine3 Neck=neck Head=head HeadTop_End=head_top LeftShoulder=left_collar "
        "LeftArm=left_shoulder LeftForeArm=left_elbow LeftHand=left_wrist LeftHandThumb1=left_fingers RightUpLeg=right_hip "
        "RightLeg=right_knee RightFoot=right_ankle RightToeBase=right_foot RightToe_End=right_foot",
    )


def test_blender_rig_with_ik_feet():
    found = read(
        "Bone Foot.L Body<Bone Hips Abdomen Torso Neck Head Shoulder.L<Torso UpperArm.L LowerArm.L Palm.L MiddleHand.L Fingers.L "
        "Thumb1.L<Palm.L UpperLeg.L<Body LowerLeg.L PoleTarget.L<Bone"
    )
    check(
        found,
        "Bone= Foot.L=left_ankle Body=pelvis Hips=pelvis Abdomen=spine1 Torso=spine3 Neck=neck Head=head Shoulder.L=left_collar "
        "UpperArm.L=left_shoulder LowerArm.L=left_elbow Palm.L=left_wrist MiddleHand.L=left_wrist Fingers.L=left_fingers "
        "UpperLeg.L=left_hip LowerLeg.L=left_knee PoleTarget.L=",
    )


def test_kaykit_and_held_things():
    found = read(
        "root hips spine chest upperarm.l lowerarm.l wrist.l hand.l handslot.l head<chest upperleg.r<hips lowerleg.r foot.r toes.r kneeIK.r<root"
    )
    check(
        found,
        "root= hips=pelvis spine=spine1 chest=spine3 upperarm.l=left_shoulder lowerarm.l=left_elbow hand.l=left_wrist",
    )
    check(found, "handslot.l=left_wrist head=head foot.r=right_ankle toes.r=right_foot kneeIK.r=")


def test_four_legs():
    found = read(
        "Body Back Torso Torso2 Torso3 Neck1 Neck2 Neck3 Head Ear1.L FrontShoulder.L<Torso2 FrontUpperLeg.L FrontLowerLeg.L BackShoulder.R<Back "
        "BackLeg.R BackUpperLeg.R BackLowerLeg.R Tail1<Back Tail2 Tail3 Tail4 IKBackLeg.R<- FFB.R IKFrontLeg.L<- FF.L"
    )
    check(
        found,
        "Back=pelvis Torso=spine1 Torso2=spine2 Torso3=spine3 Neck2=neck Head=head Ear1.L=head_top FrontShoulder.L=left_collar "
        "FrontUpperLeg.L=left_shoulder FrontLowerLeg.L=left_elbow FF.L=left_wrist BackShoulder.R=right_hip BackLeg.R=right_hip "
        "BackUpperLeg.R=right_knee BackLowerLeg.R=right_ankle FFB.R=right_foot Tail1=tail Tail2=tail Tail3=tail_tip Tail4=tail_tip",
    )


def test_dinosaur_with_a_belly_called_body():
    found = read(
        "root Body BackLeg.R BackUpLeg.R BackLowLeg.R Back<Body Tail1 Tail2 Hips<Body Torso Shoulders Neck Head FrontLeg.L<Body "
        "FrontUpLeg.L FrontLowLeg.L BackFoot.R<root FrontFoot.L<root"
    )
    check(
        found,
        "root= Body=spine1 Back=pelvis Hips=pelvis Torso=spine2 Shoulders=spine3 BackLeg.R=right_hip BackUpLeg.R=right_hip "
        "BackLowLeg.R=right_knee BackFoot.R=right_ankle FrontLeg.L=left_collar FrontUpLeg.L=left_shoulder FrontLowLeg.L=left_elbow "
        "FrontFoot.L=left_wrist Tail1=tail Tail2=tail_tip",
    )


def test_legs_of_three_segments_dragons_and_fish():
    check(
        read("Body Torso Chest Head UpperLeg.L<Body MidLeg.L LowerLeg.L FootBack.L"),
        "MidLeg.L=left_knee LowerLeg.L=left_ankle FootBack.L=left_foot",
    )
    check(
        read("Root BodyRoot Body Neck Head Face Shoulder.R<Body Wing1.R UpperLeg.R<BodyRoot"),
        "BodyRoot=pelvis Body=spine2 Face=face Wing1.R=right_wing",
    )
    check(
        read("Main1 Main2 Main3 Main4 Main5 Main6"),
        "Main1=head Main2=spine2 Main3=pelvis Main4=tail Main5=tail Main6=tail_tip",
    )
    check(
        read("Root Spine1 Spine2 Spine3 Spine4 Tail TopFlipper.L<Spine1 MidFlipper.L BottomFlipper.L Head<Root"),
        "Root=pelvis Spine1=spine2 Spine2=pelvis Spine3=tail Tail=tail_tip TopFlipper.L=left_shoulder BottomFlipper.L=left_wrist Head=head",
    )


def test_vrm_and_mmd():
    found = read(
        "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head J_Bip_L_LowerArm<J_Bip_C_UpperChest J_Bip_L_Hand J_Bip_L_Index1"
    )
    check(
        found,
        "J_Bip_C_Hips=pelvis J_Bip_C_UpperChest=spine3 J_Bip_C_Head=head J_Bip_L_LowerArm=left_elbow J_Bip_L_Hand=left_wrist J_Bip_L_Index1=left_fingers",
    )
    found = read(
        "センター 下半身 左足 左ひざ 左足首 左つま先 上半身<センター 上半身2 首 頭 右肩<上半身2 右腕 右ひじ 右手首 右親指１ 左足ＩＫ<センター"
    )
    check(
        found,
        "センター= 下半身=pelvis 左足=left_hip 左ひざ=left_knee 左足首=left_ankle 左つま先=left_foot 上半身=spine1 上半身2=spine3 首=neck "
        "頭=head 右肩=right_collar 右腕=right_shoulder 右ひじ=right_elbow 右手首=right_wrist 右親指１=right_fingers 左足ＩＫ=",
    )


@pytest.mark.parametrize("name", ["Bone", "Bone.003", "Armature", "PoleTarget.L", "control-foot-roll.l", "xyz"])
def test_names_that_say_nothing(name):
    assert handle_of_joints([name], [-1])[0] == -1


def test_a_thumb_named_for_the_wrong_side_follows_its_arm():
    text = "Hips Torso UpperArm.L LowerArm.L Hand.L Thumb.R UpperArm.R<Torso LowerArm.R Hand.R Thumb.L"
    names, _ = rig(text)
    x = {"UpperArm.L": 1.0, "LowerArm.L": 2, "Thumb.R": 3, "UpperArm.R": -1, "LowerArm.R": -2, "Thumb.L": -3}
    positions = np.array([[x.get(n, 0.0), 0, 0] for n in names])
    check(read(text, positions=positions), "Thumb.R=left_fingers Thumb.L=right_fingers UpperArm.L=left_shoulder")


def test_what_says_that_it_is_a_bone_and_corners_in_two_letters():
    said = {
        "Arm Bone.R": ("shoulder", -1), "Hand Bone.L": ("wrist", 1), "Head Bone.C": ("head", 0),
        "Leg_FL": ("arm_leg", 1), "LegBR": ("leg", -1), "RR_Foot": ("foot", -1),
    }  # fmt: skip
    assert {name: part_of_name(name)[:2] for name in said} == said


def test_a_bone_that_is_but_a_knee_is_no_segment_of_a_leg():
    names, _ = rig("Hips Thigh.L Knee.L Shin.L Foot.L Chest<Hips")
    heights = {"Hips": 1.0, "Thigh.L": 0.9, "Knee.L": 0.5, "Shin.L": 0.45, "Foot.L": 0.05, "Chest": 1.3}
    positions = np.array([[0.1 * name.endswith(".L"), heights[name], 0] for name in names])
    found = read("Hips Thigh.L Knee.L Shin.L Foot.L Chest<Hips", positions=positions)
    check(found, "Thigh.L=left_hip Knee.L=left_hip Shin.L=left_knee Foot.L=left_ankle")


def test_a_root_that_bears_legs_is_the_pelvis_and_the_thumb_of_a_foot_a_toe():
    found = read("Root Thigh.L Shin.L Foot.L FootThumb.L Thigh.R<Root Shin.R Shoulders<Root Neck Head Arm.L<Shoulders")
    check(found, "Root=pelvis FootThumb.L=left_foot Thigh.R=right_hip Shoulders=spine3 Arm.L=left_shoulder")


def test_limbs_of_two_bones_are_seen_where_bones_hold_skin():
    at = np.array([[0, 1.0, 0], [0.1, 0.9, 0], [0.1, 0.5, 0], [-0.1, 0.9, 0], [-0.1, 0.5, 0],
                   [0.2, 1.4, 0], [0.3, 1.05, 0], [-0.2, 1.4, 0], [-0.3, 1.05, 0], [0, 1.5, 0]])  # fmt: skip
    parents = np.array([-1, 0, 1, 0, 3, 0, 5, 0, 7, 0])
    skeleton = Skeleton(
        tuple(f"b{bone}" for bone in range(10)), parents, at - np.where(parents[:, None] < 0, 0, at[parents])
    )
    found = joints_by_structure(skeleton, np.ones(10))
    wanted = {"pelvis": 0, "left_hip": 1, "right_knee": 4, "left_shoulder": 5, "right_elbow": 8, "head": 9}
    assert {name: found.get(name) for name in wanted} == wanted


def test_hands_without_a_hand_bone():
    check(
        read("Hips Torso UpperArm.L LowerArm.L Index1.L Index2.L Thumb1.L<LowerArm.L"),
        "Index1.L=left_wrist Index2.L=left_fingers Thumb1.L=left_wrist",
    )


def test_left_axis_and_parts():
    names = ["Arm.L", "Arm.R", "Spine"]
    np.testing.assert_allclose(left_axis(names, np.array([[0.0, 1, -1], [0, 1, 1], [0, 0, 0]])), [0, 0, -1])
    assert left_axis(["Spine"], np.zeros((1, 3))) is None
    assert part_of_name("L.UpperLeg.001")[:2] == ("leg", 1)


def test_sides_in_one_word_with_their_limb():
    """As `arml`, `legr` of a game's monster, whose sides were not read; words that only end or begin so have none."""
    sides = {"l": 1, "r": -1}
    for limb, kind in (("arm", "shoulder"), ("leg", "leg"), ("hand", "wrist"), ("lowerleg", "leg"), ("wing", "wing")):
        for letter, side in sides.items():
            assert part_of_name(letter + limb)[:2] == part_of_name(limb + letter)[:2] == (kind, side)
    for plain in ("finger", "lower", "lowerleg", "heel", "rearleg", "radius", "collar", "armor", "handle", "tail"):
        assert part_of_name(plain)[1] == 0


def test_the_name_of_the_character_is_no_part_of_its_bones():
    body = ("Hips", "Spine", "LeftUpLeg", "RightUpLeg", "LeftHand", "Head")
    assert without_prefix([f"Neo_{name}" for name in body]) == body
    assert without_prefix([f"LowMan{name}" for name in body]) == body
    assert without_prefix(body) == body
    assert without_prefix(("LeftArm", "LeftHand", "LeftLeg", "LeftFoot", "LeftToe")) == (
        "LeftArm", "LeftHand", "LeftLeg", "LeftFoot", "LeftToe")  # fmt: skip
    assert without_prefix(["頭", "首", "左腕", "右腕"]) == ("頭", "首", "左腕", "右腕")


def test_bones_of_auto_rig_pro():
    found = read(
        "root.x spine_01.x arm_stretch.l arm_twist.l<arm_stretch.l forearm_stretch.l<arm_stretch.l "
        "forearm_twist.l<forearm_stretch.l hand.l<forearm_stretch.l neck.x<spine_01.x head.x thigh_stretch.l<root.x "
        "leg_stretch.l leg_twist.l<leg_stretch.l foot.l<leg_stretch.l thigh_twist.l<thigh_stretch.l"
    )
    check(found, "head.x=head neck.x=neck arm_stretch.l=left_shoulder arm_twist.l= forearm_stretch.l=left_elbow "
          "forearm_twist.l= hand.l=left_wrist thigh_stretch.l=left_hip leg_stretch.l=left_knee leg_twist.l= thigh_twist.l= "
          "foot.l=left_ankle")  # fmt: skip


def test_what_mmd_models_add_to_the_standard_bones():
    found = read(
        "センター 下半身 左足 左ひざ 左足首 左足D<下半身 左ひざＤ 左足首D 左足先EX 左足IK親<センター 上半身<センター 上半身2 首 頭 前髪1_1 左耳1<頭 "
        "左肩P<上半身2 左肩 左肩C 左腕 左腕捩 左腕捩1<左腕 左ひじ<左腕捩 左手捩 左手首 尻尾1<下半身 尻尾2 左つま先EX<左足首"
    )
    check(
        found,
        "左足D=left_hip 左ひざＤ=left_knee 左足首D=left_ankle 左足先EX=left_foot 左足IK親= 前髪1_1=head_top 左耳1=head_top 左肩P= 左肩C= "
        "左肩=left_collar 左腕=left_shoulder 左腕捩=left_shoulder 左腕捩1=left_shoulder 左ひじ=left_elbow 左手捩=left_elbow 左手首=left_wrist "
        "尻尾1=tail 尻尾2=tail_tip 左つま先EX=left_foot",
    )


def test_limb_parents_put_feet_back_on_legs():
    names, parents = rig("Root Body UpperLeg.L LowerLeg.L Foot.L<Root")
    handles = handle_of_joints(names, parents)
    assert limb_parents(handles, parents, np.zeros((5, 3))).tolist() == [-1, 0, 1, 2, 3]


def test_smpl_names_are_their_own_handles():
    from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS

    assert handle_of_joints(JOINT_NAMES, JOINT_PARENTS).tolist() == list(range(22))


def test_an_upper_arm_that_no_word_tells_of_is_the_bone_between():
    names = ["pelvis", "spine", "neck", "head", "collar.L", "bicep.L", "forearm.L", "hand.L", "thigh.L", "shin.L"]
    parents = [-1, 0, 1, 2, 1, 4, 5, 6, 0, 8]
    found = handle_of_joints(names, parents)
    assert HANDLE_NAMES[found[5]] == "left_shoulder" and HANDLE_NAMES[found[4]] == "left_collar"


def test_rigify_halves_of_a_leg_helpers_of_the_pelvis_and_a_spine_up_to_the_head():
    found = read(
        "DEF-spine DEF-spine.001 DEF-spine.003 DEF-spine.004 DEF-spine.006 DEF-shoulder.L<DEF-spine.003 DEF-upper_arm.L DEF-upper_arm.L.001 "
        "DEF-forearm.L DEF-hand.L DEF-pelvis.L<DEF-spine DEF-thigh.L<DEF-spine DEF-thigh.L.001 DEF-shin.L DEF-shin.L.001 DEF-foot.L DEF-toe.L",
        mass=np.ones(17),
    )
    check(
        found,
        "DEF-spine=pelvis DEF-spine.001=spine1 DEF-spine.003=spine3 DEF-spine.004=neck DEF-spine.006=head DEF-upper_arm.L.001=left_shoulder "
        "DEF-forearm.L=left_elbow DEF-pelvis.L= DEF-thigh.L=left_hip DEF-thigh.L.001=left_hip DEF-shin.L=left_knee DEF-shin.L.001=left_knee "
        "DEF-foot.L=left_ankle DEF-toe.L=left_foot",
    )
    alike = read("hips Leg.L Leg.L.001 Leg.L.002 Foot.L")  # each extruded from the one before
    check(alike, "Leg.L=left_hip Leg.L.001=left_knee Leg.L.002=left_ankle")


def test_controls_that_move_nothing_are_no_limbs():
    text = "hips spine upperarm.L lowerarm.L hand.L elbow.L<spine upperleg.L<hips lowerleg.L knee.L<hips"
    moved = [1, 1, 1, 1, 1, 0, 1, 1, 0]
    check(read(text, mass=np.array(moved, float)), "lowerarm.L=left_elbow elbow.L= lowerleg.L=left_knee knee.L=")
    check(read(text), "elbow.L=left_elbow")  # without weights there is nothing to tell it by


def test_a_part_may_be_named_after_its_limb():
    """`Front_Leg_Upper_L` and `Back_Leg_Pelvis_L` (a fox of mesh2motion); a foot of a front leg is no hind toe."""
    names = ["Hips", "Spine_1", "Head"]
    parents, positions = [-1, 0, 1], [[0, 1.0, -0.7], [0, 1.0, 0], [0, 1.3, 0.9]]
    for side, x in (("L", 0.15), ("R", -0.15)):
        first = len(names)
        for where, above, z, chain in (
            ("Front_Leg", 1, 0.4, ("Shoulder", "Upper", "Lower", "Ankle", "Foot")),
            ("Back_Leg", 0, -0.6, ("Pelvis", "Upper", "Lower", "Ankle", "Foot")),
        ):
            for rank, part in enumerate(chain):
                parents.append(above if rank == 0 else len(names) - 1)
                names.append(f"{where}_{part}_{side}")
                positions.append([x, 1.0 - 0.24 * rank, z])
        assert len(names) == first + 10
    found = handle_of_joints(names, parents, np.array(positions), np.ones(len(names)))
    said = {name: HANDLE_NAMES[handle] for name, handle in zip(names, found, strict=True) if handle >= 0}
    for side, word in (("L", "left"), ("R", "right")):
        assert [said[f"Front_Leg_{part}_{side}"] for part in ("Shoulder", "Upper", "Lower", "Ankle", "Foot")] == [
            f"{word}_{part}" for part in ("collar", "shoulder", "elbow", "wrist", "wrist")
        ]
        assert [said[f"Back_Leg_{part}_{side}"] for part in ("Pelvis", "Upper", "Lower", "Ankle", "Foot")] == [
            f"{word}_{part}" for part in ("hip", "hip", "knee", "ankle", "foot")
        ]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("J_Sec_Hair1_01", "hair"), ("J_Sec_L_CoatSkirtBack1_01", "skirt"), ("skirt_F_02.L", "skirt"),
        ("longhair_03", "hair"), ("cape_01", "cape"), ("mixamorig:Hair1", "hair"), ("Ear1.L", "ear"), ("Tail1", "tail"),
        ("beard", "hair"), ("前髪２", "hair"), ("スカート0_1", "skirt"), ("左ｽｶｰﾄ前", "skirt"), ("ﾈｸﾀｲ１", "ribbon"),
        ("左袖1_2", "sleeve"), ("ポニテ_3", "hair"), ("マント", "cape"), ("尻尾2", "tail"),
    ],
)  # fmt: skip
def test_apparel(name, kind):
    assert apparel_of_name(name) == kind and kind in APPAREL_KINDS


@pytest.mark.parametrize(
    "name",
    ["LeftForeArm", "gear", "rear_leg", "crib", "Head", "mixamorig:HeadTop_End", "TailIK", "左腕", "左足ＩＫ",
     "bow_arm",
     "UpperArmTwist", "hair_ctrl", "Spine1", ""],
)  # fmt: skip
def test_no_apparel(name):
    assert apparel_of_name(name) == ""


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


MAPPED_LIMBS = ((1, 4), (2, 5), (4, 7), (5, 8), (16, 18), (17, 19), (18, 20), (19, 21))


def degrees(rotations):
    return np.degrees(Rotation.from_matrix(np.asarray(rotations, float).reshape(-1, 3, 3)).magnitude()).reshape(
        rotations.shape[:-2]
    )


@pytest.mark.parametrize("dialect", DIALECTS, ids=str)
def test_every_dialect_moves_alike(tmp_path, dialect):
    how = DIALECTS[dialect]
    truth = walk_about(90, fps=how.rate, still=set(JOINT_NAMES) - {joint for _, _, joint, _ in how.joints})
    path = tmp_path / "take.bvh"
    path.write_text(bvh_text(truth, how))
    motion = load_motion(path)
    assert motion.fps == pytest.approx(how.rate, rel=1e-3)
    found = map_skeleton(motion.skeleton)
    assert found.convention == how.convention
    want = {joint: name for name, _, joint, share in how.joints if share == 1.0 and joint is not None}
    for name, index in zip(JOINT_NAMES, found.joints, strict=True):
        if name in want and "HeadTop" not in want[name]:
            assert index >= 0 and motion.skeleton.names[index].replace(" Pelvis", "") == want[name], (name, found)
        elif name not in want:
            assert index < 0, (name, found)
    result = to_smpl(motion, found)
    assert result.skeleton.names == JOINT_NAMES and len(result) == 90
    ours, theirs = result.world(), truth.world()
    known = [index for index, name in enumerate(JOINT_NAMES) if found.joints[index] >= 0]
    direct = [index for index in known if index == 0 or found.joints[truth.skeleton.parents[index]] >= 0]
    assert np.abs(ours[1][:, direct] - theirs[1][:, direct]).max() < 1e-3
    if how.rest == "X":
        for parent, child in MAPPED_LIMBS:
            bones = [positions[:, child] - positions[:, parent] for positions in (ours[1], theirs[1])]
            assert np.abs(bones[0] - bones[1]).max() < 1e-3
        turned = degrees(np.swapaxes(ours[0], -1, -2) @ theirs[0]).mean(axis=0)
        assert turned[0] < 3 and turned[9] < 10  # limbs bend at random here, so their roll is not known
    else:
        turned = degrees(np.swapaxes(ours[0][:, known], -1, -2) @ theirs[0][:, known]).max(axis=0)
        assert turned.max() < 0.05, dict(zip(np.array(JOINT_NAMES)[known], turned.round(2), strict=True))


def test_elbows_and_knees_say_how_limbs_are_rolled(tmp_path):
    """All bones along one axis: the rest pose says nothing, the way that hinges bend does."""
    time = np.linspace(0, 6, 60)
    bends = np.zeros((60, 22, 3))
    swing = 0.5 * np.sin(2 * time)
    for side, sign in (("left", 1), ("right", -1)):
        hip, knee, shoulder, elbow = (
            JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "shoulder", "elbow")
        )
        bends[:, hip, 0], bends[:, knee, 0] = sign * swing, 0.6 + sign * swing
        bends[:, shoulder, 2], bends[:, elbow, 1] = -sign * (1.0 + 0.2 * swing), -sign * (0.8 + swing)
    truth = walk_about(60, fps=30.0)
    rotations = Rotation.from_rotvec(bends.reshape(-1, 3)).as_matrix().reshape(60, 22, 3, 3)
    truth = SkeletalMotion(truth.skeleton, rotations, truth.root_translation, 30.0)
    (tmp_path / "take.bvh").write_text(bvh_text(truth, ALONG_X))
    result = to_smpl(load_motion(tmp_path / "take.bvh"))
    turned = degrees(np.swapaxes(result.world()[0], -1, -2) @ truth.world()[0]).max(axis=0)
    for name, angle in zip(JOINT_NAMES, turned, strict=True):
        if any(part in name for part in ("pelvis", "hip", "knee", "shoulder", "elbow", "spine")):
            assert angle < 0.5, (name, angle)


def test_a_clip_that_begins_in_a_t_pose_needs_no_rest_pose(tmp_path):
    truth = walk_about(40, fps=30.0)
    rotations = truth.rotations.copy()
    rotations[0] = np.eye(3)
    truth = SkeletalMotion(truth.skeleton, rotations, truth.root_translation, 30.0)
    (tmp_path / "take.bvh").write_text(bvh_text(truth, ALONG_X))
    result = to_smpl(load_motion(tmp_path / "take.bvh"))
    turned = degrees(np.swapaxes(result.world()[0], -1, -2) @ truth.world()[0])
    assert turned.max() < 1.0


def test_whether_a_rest_pose_is_one(tmp_path):
    for dialect, pose in ((ALONG_X, False), (CMU, True)):
        (tmp_path / "take.bvh").write_text(bvh_text(walk_about(5), dialect))
        skeleton = load_motion(tmp_path / "take.bvh").skeleton
        assert rest_is_a_pose(skeleton, map_skeleton(skeleton)) is pose


def test_names_that_are_given_win():
    skeleton = Skeleton(
        ("base", "x", "x2", "x3", "y", "y2", "y3", "back", "top"),
        [-1, 0, 1, 2, 0, 4, 5, 0, 7],
        [
            [0, 0, 0],
            [0.1, 0, 0],
            [0, -0.4, 0],
            [0, -0.4, 0],
            [-0.1, 0, 0],
            [0, -0.4, 0],
            [0, -0.4, 0],
            [0, 0.3, 0],
            [0, 0.3, 0],
        ],
    )
    names = {
        "pelvis": "base",
        "left_hip": "x",
        "left_knee": "x2",
        "right_hip": "y",
        "right_knee": "y2",
        "head": "top",
        "neck": "",
    }
    found = map_skeleton(skeleton, names)
    assert found.of("left_knee") == 2 and found.of("head") == 8 and found.of("neck") == -1
    assert found.how[JOINT_NAMES.index("left_hip")] == "given" and "left_wrist" in found.missing
    with pytest.raises(MotionError, match="'nose' in the map of names is not a joint; there are base, x"):
        map_skeleton(skeleton, {"head": "nose"})
    with pytest.raises(MotionError, match="'snout' in the map"):
        map_skeleton(skeleton, {"snout": "top"})


def test_a_skeleton_without_legs_says_what_is_missing():
    skeleton = Skeleton(("trunk", "leaf"), [-1, 0], [[0, 0, 0], [0, 1, 0]])
    with pytest.raises(MotionError, match="pelvis, left_hip, right_hip"):
        map_skeleton(skeleton)


def test_missing_parts_stay_straight_and_have_lengths(tmp_path):
    (tmp_path / "take.bvh").write_text(bvh_text(walk_about(20), DIALECTS["daz"]))
    result = to_smpl(load_motion(tmp_path / "take.bvh"))
    for name in ("spine2", "left_foot", "right_foot"):
        assert np.allclose(result.rotations[:, JOINT_NAMES.index(name)], np.eye(3), atol=1e-5)
    assert (np.linalg.norm(result.skeleton.offsets[1:], axis=-1) > 0.02).all()


@pytest.mark.parametrize("name", ["Bone", "Tail", "Spine", "Leg.L"])
def test_long_chains_of_bones_take_time_in_proportion(name):
    count = 4000
    names, parents = [f"{name}.{number:04d}" for number in range(count)], np.arange(count) - 1
    positions, start = np.arange(3.0 * count).reshape(-1, 3), time.process_time()
    handles = handle_of_joints(names, parents, positions, np.ones(count))
    assert (limb_parents(handles, parents, positions) == parents).all()
    resolve_joints(handles, parents)
    assert time.process_time() - start < 2
