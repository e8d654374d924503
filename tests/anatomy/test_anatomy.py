"""What a body is: joints, limbs, rest pose and plan."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.joints import by_limb, find_joints, limb_views, reference_joints, refined_joints
from bunraku.anatomy.legs import BodyPlan
from bunraku.anatomy.names.bone_names import handle_of_joints, rig_handles
from bunraku.anatomy.rest_pose import rest_rotations
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES, handle_names
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.synthetic.samples import make_sample


def body(width: float = 1.0) -> Anatomy:
    found = reference_body()
    size = np.array([width, 1, 1], np.float32)
    return Anatomy.of(Character("wide", found.vertices * size, found.faces), found.handles)


def calls(work, *names):
    """How often functions of these names are called by some work."""
    seen = dict.fromkeys(names, 0)

    def profile(frame, event, _):
        if event == "call" and frame.f_code.co_name in seen:
            seen[frame.f_code.co_name] += 1

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(before)
    return seen


def test_each_thing_is_worked_out_once():
    reference_anatomy()

    def work():
        found = body()
        for _ in range(3):
            assert found.plan.kind == "person" and len(found.legs) == 2 and len(found.arms) == 2
            assert found.scale == pytest.approx(1, abs=0.02) and abs(found.floor) < 0.01
            assert found.unturned.legs and found.unturned.joints.present.any()

    assert calls(work, "find_joints", "plan_of", "decimated") == {"find_joints": 1, "plan_of": 1, "decimated": 1}


def test_what_is_worked_out_is_the_objects_own_and_cannot_be_written_to():
    one, other, wider = body(), body(), body(1.2)
    assert one.joints is one.joints and one.joints is not other.joints
    np.testing.assert_array_equal(one.joints.positions, other.joints.positions)
    assert not np.array_equal(one.joints.positions, wider.joints.positions)
    with pytest.raises(ValueError, match="read-only"):
        one.joints.positions[0] = 1


def test_nothing_is_turned_in_a_body_that_is_taken_as_it_rests():
    dog = make_sample("dog", 0.3, rigged=True)
    found = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    assert found.plan == replace(found.plan, hind=2, front=2, upright=False) and isinstance(found.plan, BodyPlan)
    np.testing.assert_array_equal(found.unturned.rotations, np.tile(np.eye(3), (30, 1, 1)))
    np.testing.assert_allclose(found.unturned.stance[0].vertices, found.mesh.vertices, atol=1e-5)
    assert np.abs(found.rotations - np.eye(3)).max() > 0.1  # forelegs are arms that hang down


def test_a_rig_says_how_the_body_rests():
    found = body()
    known = Anatomy.of(found.character, found.handles, (found.rotations, found.joints))
    assert known.joints is found.joints and known.unturned.joints is found.joints
    assert known.scale == found.scale


def test_other_handles_than_those_of_a_body_are_refused():
    found = body().character
    with pytest.raises(CharacterError, match="30 handles, not 5"):
        Anatomy.of(found, Handles(np.zeros((5, 3)), np.eye(5)[np.zeros(len(found.vertices), int)]))


def test_what_reaches_the_ground_is_the_lowest_of_all_that_may_stand():
    found = body()
    angles = np.radians([0, 20, 50, 80])
    turns = np.tile(np.eye(3), (4, 1, 1))
    turns[:, 1:, 1:] = [[[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]] for a in angles]  # falls on its face
    still = np.tile(np.eye(3), (4, HANDLE_COUNT, 1, 1))
    motion = HandleMotion(np.zeros((4, HANDLE_COUNT, 3)), still, np.zeros((4, 3)), turns, 20.0)
    seen = found.reach.lowest(motion.transforms(found.handles.positions))
    points, root = found.mesh.vertices[found.stands], found.handles.positions[0]
    true = ((points - root) @ turns.swapaxes(1, 2))[..., 1].min(axis=1) + root[1]
    assert (seen >= true - 1e-5).all() and (seen <= true + 0.01).all()


SHOULDER, ELBOW = HANDLE_NAMES.index("left_shoulder"), HANDLE_NAMES.index("left_elbow")


def pieces(trace):
    """Two pieces of an arm that touch at x = 0.5, and a head far above with a trace of both."""
    boxes = [trimesh.creation.box((0.5, 0.1, 0.1)).subdivide().subdivide() for _ in range(2)]
    head = trimesh.creation.box((0.4, 0.4, 0.4)).subdivide().apply_translation((0, 1, 0))
    for number, box in enumerate(boxes):
        box.apply_translation((0.25 + 0.5 * number, 0, 0))
    whole = trimesh.util.concatenate([*boxes, head])
    weights = np.zeros((len(whole.vertices), HANDLE_COUNT), np.float32)
    first, second = len(boxes[0].vertices), 2 * len(boxes[0].vertices)
    weights[:first, SHOULDER], weights[first:second, ELBOW] = 1, 1
    weights[second:, [SHOULDER, ELBOW]] = trace
    weights[second:, HANDLE_NAMES.index("head")] = 1 - 2 * trace
    character = Character("arm", whole.vertices.astype(np.float32), whole.faces)
    mass = weights * character.areas[:, None]
    positions = (mass.T @ character.vertices) / np.maximum(mass.sum(axis=0), 1e-12)[:, None]
    return character, Handles(positions.astype(np.float32), weights)


def test_pieces_meet_where_they_are_nearest():
    for trace in (0.0, 0.02):  # a trace of both anywhere else is no joint
        joint = find_joints(*pieces(trace)).positions[ELBOW]
        assert np.abs(joint - [0.5, 0, 0]).max() < 0.07


def test_a_trace_of_an_arm_on_what_lies_elsewhere_is_no_elbow():
    character, handles = pieces(0.2)  # as much as parts that blend have
    joint = find_joints(character, handles).positions[ELBOW]
    assert np.abs(joint - [0.5, 0, 0]).max() < 0.1


H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
LEG = ("hip", "knee", "ankle", "foot")
SPARE = {
    "left": ("head_top", "face", "left_wing", "tail"),
    "right": ("left_fingers", "right_fingers", "right_wing", "tail_tip"),
}


def two_bodies() -> tuple[Character, Handles]:
    """Two reference bodies, one a metre behind the other, of which the second has only legs that move on their own."""
    body = reference_body()
    count = len(body.vertices)
    vertices = np.concatenate([body.vertices, body.vertices - [0, 0, 1]])
    weights = np.concatenate([body.handle_weights] * 2)
    roles = np.arange(len(HANDLE_NAMES))
    for side, spare in SPARE.items():
        for name in spare:
            weights[:, 0] += weights[:, H[name]]
            weights[:, H[name]] = 0
        for part, name in zip(LEG, spare, strict=True):
            weights[count:, H[name]] = weights[count:, H[f"{side}_{part}"]]
            weights[count:, H[f"{side}_{part}"]] = 0
            roles[H[name]] = H[f"{side}_{part}"]
    character = Character("two", vertices, np.concatenate([body.faces, body.faces + count]))
    areas = np.ones(len(vertices))
    return character, Handles(handle_positions(vertices, weights, areas), weights, roles=roles)


def test_limbs_are_found_from_the_body_outwards() -> None:
    _, handles = two_bodies()
    views = limb_views(handles)
    assert len(views) == 3
    for view, side in zip(views[1:], ("left", "right"), strict=True):
        assert [view.members[H[f"{side}_{part}"]] for part in LEG] == [H[name] for name in SPARE[side]]
        np.testing.assert_allclose(view.handles.weights.sum(axis=1), 1, atol=1e-4)


def test_further_joints_hang_on_their_own_limb() -> None:
    character, handles = two_bodies()
    joints = Anatomy.of(character, handles).joints
    for side, spare in SPARE.items():
        hip, knee, ankle, foot = (H[name] for name in spare)
        assert [joints.parents[k] for k in (hip, knee, ankle, foot)] == [0, hip, knee, ankle]
        behind = joints.positions[[knee, ankle]] - joints.positions[[H[f"{side}_knee"], H[f"{side}_ankle"]]]
        np.testing.assert_allclose(behind, [[0, 0, -1]] * 2, atol=0.02)


def test_every_leg_does_what_the_first_does_about_its_own_hip() -> None:
    character, handles = two_bodies()
    rotations = np.tile(np.eye(3), (2, len(HANDLE_NAMES), 1, 1))
    rotations[1, [H[f"left_{part}"] for part in LEG]] = matrix_from_axis_angle(np.array([-0.8, 0, 0]))
    motion = HandleMotion(
        np.zeros((2, len(HANDLE_NAMES), 3)), rotations, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    )
    fitted = fit_motion(motion, Anatomy.of(character, handles), Stages(ground=False))
    np.testing.assert_allclose(fitted.rotations[:, H["head_top"]], fitted.rotations[:, H["left_hip"]], atol=1e-5)
    posed = skin(character.vertices, handles.weights, fitted.transforms(handles.positions))
    half = len(character.vertices) // 2
    shin = np.flatnonzero(handles.weights[:half, H["left_knee"]] > 0.99)
    np.testing.assert_allclose(
        posed[1, half + shin] - posed[1, shin], np.broadcast_to([0, 0, -1], (len(shin), 3)), atol=0.06
    )
    other = np.flatnonzero(handles.weights[half:, H[SPARE["right"][1]]] > 0.99) + half
    np.testing.assert_allclose(posed[1, other], posed[0, other], atol=0.02)


def test_plain_handles_are_solved_once() -> None:
    body = reference_body()
    seen = []
    by_limb(body.handles, lambda plain: seen.append(plain) or Anatomy.of(body.character(), plain).rest)
    assert len(seen) == 1 and seen[0].roles is None


def test_names_of_further_joints_say_what_they_are() -> None:
    names = handle_names(two_bodies()[1].played)
    assert names[H["head_top"]] == "left_hip_2" and names[H["tail_tip"]] == "right_foot_2" and names[0] == "pelvis"
    assert len(set(names)) == len(names)


def test_their_names_are_understood() -> None:
    handles = two_bodies()[1]
    count = len(HANDLE_NAMES)
    known = handle_of_joints(
        handle_names(handles.played), np.array([-1, *[0] * (count - 1)]), handles.positions, np.ones(count)
    )
    assert known.tolist() == handles.played.tolist()


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
    eyes = np.tile(np.eye(3), (20, 30, 1, 1))
    motion = HandleMotion(np.zeros((20, 30, 3)), eyes, np.zeros((20, 3)), eyes[:, 0])  # the reference body stands
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
