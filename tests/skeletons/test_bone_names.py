# ruff: noqa: E501 - rigs read best on one line
import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.skeletons.bone_names import handle_of_joints, limb_parents
from bunraku.skeletons.bone_words import left_axis, part_of_name, without_prefix


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
    from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS

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
