"""The same body in other rest poses: its limbs are turned to where the reference body's are, and it stands up."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import find_joints, reference_joints, refined_joints
from bunraku.anatomy.rest_pose import rest_rotations
from bunraku.body.layout import HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.surface import vertex_areas
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.evaluation.handles.rest_pose_transfer import code_made_motions

POSES = {
    "A": {"shoulder": ("z", -45)},
    "arms down": {"shoulder": ("z", -80)},
    "sitting": {"shoulder": ("z", -45), "hip": ("x", -90), "knee": ("x", 90)},
    "kneeling": {"shoulder": ("z", -60), "knee": ("x", 90)},
    "crouching": {"shoulder": ("z", -60), "hip": ("x", -70), "knee": ("x", 105)},
    "arms forward": {"shoulder": ("y", -90)},
}


def posed(pose):
    """The reference body in a rest pose, as a character of its own, and the turn of each of its joints that made it."""
    body = reference_body()
    rotations = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    for part, (axis, degrees) in POSES[pose].items():
        for side, sign in (("left", 1), ("right", 1 if axis == "x" else -1)):
            rotations[0, JOINT_NAMES.index(f"{side}_{part}")] = Rotation.from_euler(
                axis, sign * degrees, degrees=True
            ).as_matrix()
    motion = SkeletalMotion(body.skeleton, rotations, body.joints[:1])
    vertices = body.pose(motion)[0]
    positions = handle_positions(vertices, body.handle_weights, vertex_areas(vertices, body.faces))
    return Character(pose, vertices, body.faces), Handles(positions, body.handle_weights), *motion.world()


@pytest.mark.parametrize("pose", POSES)
def test_limbs_are_turned_back_as_far_as_they_were_turned(pose):
    character, handles, world, _ = posed(pose)
    turns = Anatomy.of(character, handles).rotations
    for part in ("shoulder", "elbow", "wrist", "hip", "knee"):
        for side in ("left", "right"):
            left = turns[HANDLE_NAMES.index(f"{side}_{part}")] @ world[0, JOINT_NAMES.index(f"{side}_{part}")]
            assert np.degrees(np.linalg.norm(Rotation.from_matrix(left).as_rotvec())) < 7, f"{side}_{part}"


def test_a_straight_arm_turns_as_one_though_its_elbow_is_found_badly():
    body, joints = reference_body(), reference_joints()
    shoulder, elbow, wrist = (HANDLE_NAMES.index(f"left_{part}") for part in ("shoulder", "elbow", "wrist"))
    positions = joints.positions.copy()
    off = 0.2 * np.linalg.norm(positions[elbow] - positions[shoulder])
    for move, most in ((0.0, 1e-6), (off, 1.0)):
        positions[elbow] = joints.positions[elbow] + [0, move, 0]
        found = replace(joints, positions=positions)
        turns = rest_rotations(body.handles, found, body.handles, joints, 1.7)
        for part in (shoulder, elbow):
            assert np.degrees(np.linalg.norm(Rotation.from_matrix(turns[part]).as_rotvec())) <= most
    bent = joints.positions.copy()
    bent[wrist] = bent[elbow] + [0, 0, 0.25]  # the forearm points forward
    turns = rest_rotations(body.handles, replace(joints, positions=bent), body.handles, joints, 1.7)
    ahead = turns[elbow] @ [0, 0, 1]
    straight = joints.positions[wrist] - joints.positions[elbow]
    assert ahead @ straight > 0.99 * np.linalg.norm(straight)


@pytest.mark.parametrize("pose", POSES)
def test_bent_joints_are_found(pose):
    character, handles, world, where = posed(pose)
    turns = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    turns[:JOINT_COUNT] = world[0].transpose(0, 2, 1)
    joints = refined_joints(character, handles, find_joints(character, handles), turns)
    for part in ("elbow", "wrist", "hip", "knee", "ankle"):
        joint = JOINT_NAMES.index(f"left_{part}")
        assert np.linalg.norm(joints.positions[joint] - where[0, joint]) < 0.02 * reference_body().character().height, (
            part
        )


def test_who_sits_stands_up_on_the_same_floor():
    body = reference_body()
    character, handles, *_ = posed("sitting")
    stance, _ = Anatomy.of(character, handles).stance
    assert np.ptp(stance.vertices[:, 1]) == pytest.approx(np.ptp(body.vertices[:, 1]), rel=0.03)
    assert (
        np.linalg.norm(
            (stance.vertices - body.vertices) - (stance.vertices - body.vertices).mean(axis=0), axis=1
        ).mean()
        < 0.015 * 1.7
    )
    motion = code_made_motions(1.0)["walk"]
    for stages in (Stages(), Stages(ground=False)):
        moved = Animation(character, handles, fit_motion(motion, Anatomy.of(character, handles), stages)).vertices()
        assert np.abs(moved[..., 1].min(axis=1) - character.vertices[:, 1].min()).max() < 0.03 * body.character().height


def test_feet_that_go_with_their_shins_end_flat():
    character, handles, world, _ = posed("kneeling")
    foot = HANDLE_NAMES.index("left_ankle")
    turns = Anatomy.of(character, handles).rotations
    left = turns[foot] @ world[0, JOINT_NAMES.index("left_ankle")]
    assert np.degrees(np.linalg.norm(Rotation.from_matrix(left).as_rotvec())) < 8
    flat = Anatomy.of(reference_body().character(), reference_body().handles).rotations
    np.testing.assert_allclose(flat[foot], np.eye(3), atol=0.05)
