"""Every leg of a character with many turns about its own hip."""

from __future__ import annotations

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.limbs import by_limb, limb_views
from bunraku.body.layout import HANDLE_NAMES, handle_names
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.skeletons.bone_names import handle_of_joints

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
    names = handle_names(two_bodies()[1])
    assert names[H["head_top"]] == "left_hip_2" and names[H["tail_tip"]] == "right_foot_2" and names[0] == "pelvis"
    assert len(set(names)) == len(names)


def test_their_names_are_understood() -> None:
    handles = two_bodies()[1]
    count = len(HANDLE_NAMES)
    known = handle_of_joints(
        handle_names(handles), np.array([-1, *[0] * (count - 1)]), handles.positions, np.ones(count)
    )
    assert known.tolist() == handles.played.tolist()
