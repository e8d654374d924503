"""Motion on a character's own rig: limbs point where the source's point, bones keep their lengths, and the way back
leads back.
"""

from dataclasses import replace

import numpy as np
import pytest

from bunraku import CharacterError, SkeletalMotion
from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.body.smpl_rest import LIMB_CHILD
from bunraku.core.character import Character, Rig
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.retarget.body_motion import body_handle_motion
from bunraku.retarget.fit import Stages
from bunraku.retarget.rig_motion import handle_animation, rig_to_reference
from bunraku.retarget.rig_parts import RigParts, is_humanoid_rig
from bunraku.retarget.same_rig import copied_bones
from bunraku.retarget.to_rig import fit_rig

CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)
_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}


def walking(frames=24):
    """Something like a walk: legs and arms swing, elbows and knees bend, the pelvis goes forward."""
    body = reference_body()
    phase = np.linspace(0, 2 * np.pi, frames)
    turns = np.zeros((frames, 22, 3))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, _J[f"{side}_hip"], 0] = -0.5 * sign * np.sin(phase)
        turns[:, _J[f"{side}_knee"], 0] = 0.4 - 0.4 * sign * np.cos(phase)
        turns[:, _J[f"{side}_shoulder"], 2] = -1.2 * sign
        turns[:, _J[f"{side}_elbow"], 1] = -0.6 * sign
    turns[:, _J["spine2"], 1] = 0.2 * np.sin(phase)
    path = body.joints[0] + np.stack([0 * phase, 0.02 * np.cos(2 * phase), 0.15 * phase], axis=1)
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), path, 20.0)


def rested(scale=1.0, arms=0.0):
    """The reference body in another size, with its arms down by an angle [rad] in its rest pose."""
    body = reference_body()
    turns = np.zeros((1, 22, 3))
    for side, sign in (("left", -1), ("right", 1)):
        turns[0, _J[f"{side}_shoulder"], 2] = sign * arms
    rotations, positions = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), body.joints[:1]).world()
    affine = np.concatenate(
        [rotations, (positions - np.einsum("njab,jb->nja", rotations, body.joints))[..., None]], axis=-1
    )
    plain, transforms = body.character(), np.tile(np.eye(4), (22, 1, 1))
    transforms[:, :3, 3] = positions[0] * scale
    rig = Rig(JOINT_NAMES, plain.rig.parents, transforms, plain.rig.indices, plain.rig.weights)
    return Character("rested", skin(body.vertices, body.joint_weights, affine)[0] * np.float32(scale), body.faces, rig)


def limbs(positions):
    bones = np.stack([positions[:, child] - positions[:, joint] for joint, child in LIMB_CHILD.items()], axis=1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def test_stiff_motion_has_the_rotations_of_the_joints():
    motion = walking()
    handles = body_handle_motion(motion)
    world = motion.world()[0]
    assert np.abs(handles.root_rotation[:, None] @ handles.rotations[:, :22] - world).max() < 1e-5


@pytest.mark.parametrize(("scale", "arms"), [(1.0, 0.0), (1.0, 1.1), (0.4, 0.6)])
def test_limbs_point_where_those_of_the_source_point(scale, arms):
    motion = walking()
    character = rested(scale, arms)
    moved = fit_rig(body_handle_motion(motion), character, CARRIED)
    want, have = limbs(motion.world()[1]), limbs(moved.world()[1])
    angles = np.degrees(np.arccos(np.clip((want * have).sum(axis=-1), -1, 1)))
    assert angles.max() < 0.5
    assert np.abs(moved.translations[:, 1:]).max() < 1e-4 * scale  # bones keep their lengths
    stride = moved.world()[1][:, 0, 2]
    assert stride[-1] - stride[0] == pytest.approx(scale * 0.3 * np.pi, rel=0.1)


def test_all_stages_stay_close_to_the_source():
    motion = walking()
    moved = fit_rig(body_handle_motion(motion), rested(1.0, 0.8), Stages(hands=True))
    angles = np.degrees(np.arccos(np.clip((limbs(motion.world()[1]) * limbs(moved.world()[1])).sum(axis=-1), -1, 1)))
    assert angles.mean() < 5
    assert moved.vertices()[..., 1].min() > -0.02


def test_the_way_back():
    reference = body_handle_motion(walking())
    parts = RigParts.of(rested(0.7, 0.9))
    moved = fit_rig(reference, parts, CARRIED)
    back = rig_to_reference(parts, *moved.world(), 20.0, own=True)
    assert (
        np.degrees(
            np.linalg.norm(
                axis_angle_from_matrix(np.swapaxes(back.rotations, -1, -2) @ reference.rotations)[:, 1:22], axis=-1
            )
        ).max()
        < 0.5
    )
    assert np.abs(back.root_translation - reference.root_translation).max() < 0.01
    again = fit_rig(back, parts, CARRIED)
    assert np.abs(again.vertices() - moved.vertices()).max() < 0.005 * parts.character.height


def test_the_rig_as_handles_is_the_same_animation():
    moved = fit_rig(body_handle_motion(walking()), rested(1.0, 0.5))
    assert np.abs(handle_animation(moved).vertices() - moved.vertices()).max() < 1e-3


def test_which_rigs_are_humanoid():
    character = rested()
    assert is_humanoid_rig(character)
    nameless = replace(character.rig, names=tuple(f"bone{number}" for number in range(22)))
    assert not is_humanoid_rig(replace(character, rig=nameless))
    with pytest.raises(CharacterError, match="do not tell"):
        RigParts.of(replace(character, rig=nameless))
    with pytest.raises(CharacterError, match="no rig"):
        RigParts.of(replace(character, rig=None))


def test_bones_of_the_same_skeleton_are_copied():
    moved = fit_rig(body_handle_motion(walking()), rested(1.0, 0.5), CARRIED)
    other = rested(2.0, 0.5)
    copied = copied_bones(moved.character, *moved.world(), 20.0, other)
    assert np.abs(copied.vertices() - 2 * moved.vertices()).max() < 1e-3
    assert copied_bones(moved.character, *moved.world(), 20.0, rested(2.0, 1.5)) is None  # rests in another pose
    renamed = replace(other.rig, names=("hips", *other.rig.names[1:]))
    assert copied_bones(moved.character, *moved.world(), 20.0, replace(other, rig=renamed)) is None


def test_a_wrist_bone_over_the_hand_leaves_the_turn_to_the_hand():
    plain = rested(1.0, 0.5)
    parts = {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "hip": "upperleg", "knee": "lowerleg",
    "ankle": "foot", "foot": "toes",
             "shoulder": "upperarm", "elbow": "lowerarm", "collar": "clavicle"}  # fmt: skip
    names = []
    for name in JOINT_NAMES:
        side, _, part = name.rpartition("_")
        names.append(f"{parts.get(part, part)}{'.' + side[0] if side else ''}")
    wrists = [names.index("wrist.l"), names.index("wrist.r")]
    rig, weights = plain.rig, plain.rig.dense_weights()
    hands = 0.8 * weights[:, wrists]
    weights[:, wrists] -= hands
    weights = np.concatenate([weights, hands], axis=1)
    order = np.argsort(-weights, axis=1)[:, :6]
    transforms = np.concatenate([rig.transforms, rig.transforms[wrists]])
    with_hands = Rig(
        (*names, "hand.l", "hand.r"),
        np.append(rig.parents, wrists),
        transforms,
        order,
        np.take_along_axis(weights, order, axis=1),
    )
    found = RigParts.of(replace(plain, rig=with_hands))
    assert found.humanoid and found.leads[[_J["left_wrist"], _J["right_wrist"]]].tolist() == [22, 23]
    moved = fit_rig(body_handle_motion(walking()), found, CARRIED)
    turns = np.array(moved.rotations)
    turns[:, 22] = matrix_from_axis_angle(np.array([0.7, 0.2, 0.1]))  # as a clip turns it
    clip = replace(moved, rotations=turns)
    back = fit_rig(rig_to_reference(found, *clip.world(), 20.0, own=True), found, CARRIED)
    assert np.abs(back.vertices() - clip.vertices()).max() < 0.005 * plain.height


def test_half_of_a_pelvis_over_a_thigh_leaves_the_hip_to_the_thigh():
    plain = rested()
    parts = {"pelvis": "hips", "hip": "upperleg", "knee": "lowerleg", "ankle": "foot", "foot": "toes",
             "shoulder": "upperarm", "elbow": "lowerarm", "collar": "clavicle"}  # fmt: skip
    names = []
    for name in JOINT_NAMES:
        side, _, part = name.rpartition("_")
        names.append(f"{parts.get(part, part)}{'.' + side[0] if side else ''}")
    rig, hips = plain.rig, [_J["left_hip"], _J["right_hip"]]
    parents = np.append(rig.parents, [0, 0])
    parents[hips] = [22, 23]
    transforms = np.concatenate([rig.transforms, rig.transforms[hips]])
    transforms[22:, 1, 3] += 0.1
    weights = np.concatenate([rig.dense_weights(), np.zeros((len(plain.vertices), 2))], axis=1)
    order = np.argsort(-weights, axis=1)[:, :4]
    halved = Rig(
        (*names, "pelvis.l", "pelvis.r"), parents, transforms, order, np.take_along_axis(weights, order, axis=1)
    )
    found = RigParts.of(replace(plain, rig=halved))
    assert found.leads[hips].tolist() == hips and (found.parts[22:] == -1).all()
    np.testing.assert_allclose(found.joints.positions[hips], rig.transforms[hips][:, :3, 3], atol=1e-6)
