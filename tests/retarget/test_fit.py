"""Fitting a motion to a body, and its stages."""

import inspect
import itertools
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bunraku
from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.joints import find_joints
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.files import load_character, save_character
from bunraku.retarget.engine_skeleton import on_skeleton
from bunraku.retarget.fit import STAGES, Stages, fit_motion, running
from bunraku.retarget.stages.stage import Fitting
from bunraku.retarget.to_reference import motion_to_reference
from bunraku_lab.datasets.motions.build import handle_motion_of_body
from bunraku_lab.synthetic.samples import make_sample


def swing(frames=20):
    """Arms come down from the T-pose and the knees bend."""
    body = reference_body()
    share = np.linspace(0, 1, frames)
    rotations = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    for name, axis, degrees in (
        ("left_shoulder", "z", -70),
        ("right_shoulder", "z", 70),
        ("left_knee", "x", 60),
        ("left_hip", "x", -60),
    ):
        rotations[:, JOINT_NAMES.index(name)] = Rotation.from_rotvec(
            np.radians(share * degrees)[:, None] * np.eye(3)["xyz".index(axis)]
        ).as_matrix()
    return handle_motion_of_body(SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (frames, 1))))


def rigid_pose(body, joint, rotation):
    """The body with one joint turned, as another character whose rest pose that is."""
    rotations = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    for name in joint:
        rotations[0, JOINT_NAMES.index(name)] = rotation if name.startswith("left") else rotation.T
    vertices = body.pose(SkeletalMotion(body.skeleton, rotations, body.joints[:1]))[0]
    character = Character("posed", vertices, body.faces)
    return character, Handles(
        handle_positions(vertices, body.handle_weights, vertex_areas(vertices, body.faces)), body.handle_weights
    )


def test_the_reference_body_keeps_its_own_motion():
    body, motion = reference_body(), swing()
    character = body.character()
    fitted = fit_motion(
        motion, Anatomy.of(character, body.handles), Stages(feet=False)
    )  # its left foot slides as it is raised
    before, after = (Animation(character, body.handles, m).vertices() for m in (motion, fitted))
    assert np.linalg.norm(after - before, axis=-1).max() < 0.005 * character.height


def test_joints_are_found_where_weights_meet():
    body = reference_body()
    joints = find_joints(body.character(), body.handles)
    for name in ("left_elbow", "right_knee", "left_wrist"):
        index = HANDLE_NAMES.index(name)
        assert np.linalg.norm(joints.positions[index] - body.joints[index]) < 0.03 * body.character().height
    assert not joints.present[HANDLE_NAMES.index("tail")]


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_size_changes_the_animation_by_its_own_factor(scale):
    body, motion = reference_body(), swing()
    small = Character("small", body.vertices * scale, body.faces)
    handles = Handles(body.handles.positions * scale, body.handle_weights)
    want = Animation(
        body.character(), body.handles, fit_motion(motion, Anatomy.of(body.character(), body.handles))
    ).vertices()
    got = Animation(small, handles, fit_motion(motion, Anatomy.of(small, handles))).vertices() / scale
    np.testing.assert_allclose(got, want, atol=2e-4 * small.height / scale)


def test_an_a_pose_ends_in_the_same_pose_as_a_t_pose():
    body, motion = reference_body(), swing()
    down = Rotation.from_euler("z", -45, degrees=True).as_matrix()
    character, handles = rigid_pose(body, ("left_shoulder", "right_shoulder"), down)
    want = Animation(body.character(), body.handles, motion).vertices()[-1]
    with_stage = Animation(character, handles, fit_motion(motion, Anatomy.of(character, handles))).vertices()[-1]
    without = Animation(
        character, handles, fit_motion(motion, Anatomy.of(character, handles), Stages(rest_pose=False))
    ).vertices()[-1]
    hands = body.handle_weights[:, HANDLE_NAMES.index("left_wrist")] > 0.5
    near = np.linalg.norm(with_stage[hands] - want[hands], axis=1).mean() / character.height
    far = np.linalg.norm(without[hands] - want[hands], axis=1).mean() / character.height
    assert near < 0.06 < 0.2 < far


@pytest.mark.parametrize(("axes", "degrees"), [("z", [-80]), ("y", [-70]), ("zy", [-40, -60])])
def test_a_vrm_is_written_of_a_body_that_stands_in_no_t_pose(axes, degrees, tmp_path):
    """Arms that hang, reach forward, or are held aside with bent elbows: its T-pose has them along the x axis."""
    turned = Rotation.from_euler(axes, degrees, degrees=True).as_matrix().reshape(3, 3)
    joints = ("left_shoulder", "right_shoulder", "left_elbow", "right_elbow")
    shown = on_skeleton(Anatomy.of(*rigid_pose(reference_body(), joints, turned)), "vrm")
    read = load_character(save_character(shown, tmp_path / "a.vrm", rig=True)).rig
    arm = np.subtract(*(read.positions[read.names.index(name)] for name in ("leftHand", "leftUpperArm")))
    assert arm[0] > 0.99 * np.linalg.norm(arm)


def test_long_arms_stay_attached():
    body, motion = reference_body(), swing()
    vertices = body.vertices * np.array(
        [1.6, 1, 1], np.float32
    )  # arms and shoulders 60 % longer than the motion was made for
    character, handles = (
        Character("wide", vertices, body.faces),
        Handles(body.handles.positions * [1.6, 1, 1], body.handle_weights),
    )
    edges = np.unique(np.sort(body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)

    def stretch(stages):
        posed = Animation(character, handles, fit_motion(motion, Anatomy.of(character, handles), stages)).vertices()
        rest = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        return np.quantile(np.linalg.norm(posed[:, edges[:, 0]] - posed[:, edges[:, 1]], axis=-1) / rest, 0.99)

    assert stretch(Stages()) - 1 < 0.5 * (stretch(Stages(attach=False)) - 1)


def test_ground_is_kept():
    body, motion = reference_body(), swing()
    short = body.vertices * np.where(body.vertices[:, 1:2] < 0.9, [1, 0.5, 1], [1, 1, 1]) + np.where(
        body.vertices[:, 1:2] < 0.9, [0, 0.45, 0], [0, 0, 0]
    )
    short = (short - [0, short[:, 1].min(), 0]).astype(np.float32)
    character, handles = (
        Character("short", short, body.faces),
        Handles(body.handles.positions - [0, 0.45, 0], body.handle_weights),
    )
    lowest = (
        Animation(character, handles, fit_motion(motion, Anatomy.of(character, handles))).vertices()[..., 1].min(axis=1)
    )
    assert np.abs(lowest).max() < 0.03 * character.height


def test_an_absent_handle_follows_its_parent():
    body, motion = reference_body(), swing()
    weights = body.handle_weights.copy()
    for part in ("wrist", "fingers"):  # a character without hands: its forearm holds them
        for side in ("left", "right"):
            weights[:, HANDLE_NAMES.index(f"{side}_elbow")] += weights[:, HANDLE_NAMES.index(f"{side}_{part}")]
            weights[:, HANDLE_NAMES.index(f"{side}_{part}")] = 0
    fitted = fit_motion(motion, Anatomy.of(body.character(), Handles(body.handles.positions, weights)))
    wrist, elbow = HANDLE_NAMES.index("left_wrist"), HANDLE_NAMES.index("left_elbow")
    np.testing.assert_allclose(fitted.rotations[:, wrist], fitted.rotations[:, elbow], atol=1e-6)


@pytest.mark.parametrize(
    ("degrees", "arms", "straightened"),
    [(15, False, True), (48, False, False), (48, True, True), (85, False, True), (85, True, True)],
)
def test_bent_legs_are_straightened_unless_they_are_built_so(degrees, arms, straightened):
    body, motion = reference_body(), swing(3)
    bend = Rotation.from_euler("x", -degrees, degrees=True).as_matrix()  # both thighs forward
    rotations = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    for name in ("left_hip", "right_hip"):
        rotations[0, JOINT_NAMES.index(name)] = bend
    vertices = body.pose(SkeletalMotion(body.skeleton, rotations, body.joints[:1]))[0]
    weights = body.handle_weights.copy()
    if not arms:  # as a bird or a walking machine
        limbs = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("shoulder", "elbow", "wrist", "fingers"))]
        weights[:, HANDLE_NAMES.index("spine3")] += weights[:, limbs].sum(axis=1)
        weights[:, limbs] = 0
    character = Character("bent", vertices, body.faces)
    handles = Handles(handle_positions(vertices, weights, vertex_areas(vertices, body.faces)), weights)
    thigh = fit_motion(motion, Anatomy.of(character, handles)).rotations[0, HANDLE_NAMES.index("right_hip")]
    angle = np.degrees(np.linalg.norm(Rotation.from_matrix(thigh).as_rotvec()))
    assert angle == pytest.approx(degrees if straightened else 0, abs=6)


def test_the_way_to_a_character_and_back_is_the_same_motion():
    body, motion = reference_body(), swing()
    down = Rotation.from_euler("z", -45, degrees=True).as_matrix()
    character, handles = rigid_pose(body, ("left_shoulder", "right_shoulder"), down)
    back = motion_to_reference(fit_motion(motion, Anatomy.of(character, handles)), Anatomy.of(character, handles))
    one, other = (Animation(body.character(), body.handles, m).vertices() for m in (motion, back))
    assert np.linalg.norm(one - other, axis=-1).mean() < 0.01 * body.character().height


def test_feet_stay_on_the_ground_when_a_hand_holds_something_that_hangs_lower():
    body, motion = reference_body(), swing()
    wrist = HANDLE_NAMES.index("left_wrist")
    hand = body.handles.positions[wrist]
    pole = hand + np.array(
        [[0, 0, 0], [1.3, 0.02, 0], [1.3, -0.02, 0.02]], np.float32
    )  # below the feet once the arm comes down
    vertices = np.concatenate([body.vertices, pole])
    faces = np.concatenate([body.faces, [np.arange(3) + len(body.vertices)]])
    weights = np.concatenate([body.handle_weights, np.eye(len(body.handles.positions), dtype=np.float32)[[wrist] * 3]])
    character, handles = Character("armed", vertices, faces), Handles(body.handles.positions, weights)
    posed = Animation(character, handles, fit_motion(motion, Anatomy.of(character, handles))).vertices()
    assert posed[-1, -3:, 1].min() < -0.1  # it does hang lower
    assert np.abs(posed[:, : len(body.vertices), 1].min(axis=1)).max() < 0.03 * character.height


def test_a_body_that_lies_along_its_spine_takes_a_third_of_the_tilt():
    body = reference_body()
    rotations = np.tile(np.eye(3), (10, JOINT_COUNT, 1, 1))
    rotations[:, 0] = Rotation.from_euler("x", 60, degrees=True).as_matrix()  # the pelvis bends forward
    motion = handle_motion_of_body(SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (10, 1))))
    lying = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    vertices = (body.vertices @ lying.T).astype(np.float32)
    dog, handles = (
        Character("dog", vertices, body.faces),
        Handles(body.handles.positions @ lying.T, body.handle_weights),
    )

    def tilt(fitted):
        return np.degrees(np.linalg.norm(Rotation.from_matrix(fitted.root_rotation[5]).as_rotvec()))

    assert tilt(fit_motion(motion, Anatomy.of(body.character(), body.handles))) == pytest.approx(60, abs=3)
    assert tilt(fit_motion(motion, Anatomy.of(dog, handles))) == pytest.approx(20, abs=3)


DOCS = Path(__file__).resolve().parents[2] / "docs"


def said(stage) -> str:
    """The first line of a stage's docstring."""
    return inspect.getdoc(stage).splitlines()[0]


def test_switches_are_the_list():
    assert bunraku.Stages is Stages
    assert [field.name for field in fields(Stages)] == [stage.name for stage in STAGES]
    assert [field.name for field in fields(Stages) if not field.default] == ["shape", "hands"]
    words = dict(re.findall(r"^    (\w+): (.*)$", inspect.getdoc(Stages), re.MULTILINE))
    assert words == {stage.name: said(stage) for stage in STAGES}


def test_docs_print_the_list():
    text = (DOCS / "how-it-works.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\d+\. `([a-z-]+)`: (.*)$", text[text.index("retarget/fit.py`") :], re.MULTILINE)
    assert listed == [(stage.name.replace("_", "-"), said(stage)) for stage in STAGES]


def test_the_command_line_s_page_lists_them():
    rows = [line for line in (DOCS / "cli.md").read_text(encoding="utf-8").splitlines() if "`smooth`, `gait`" in line]
    assert len(rows) == 1
    assert re.findall(r"`([a-z-]+)`", rows[0].split(":", 1)[1]) == [stage.name.replace("_", "-") for stage in STAGES]


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_a_stage_needs_only_what_there_is_and_runs_alone(stage):
    names = [other.name for other in STAGES]
    assert set(stage.needs) <= set(names)
    alone = Stages(**{name: name == stage.name or name in stage.needs for name in names})
    assert [other.name for other in running(alone)] == [
        name for name in names if name == stage.name or name in stage.needs
    ]
    without = Stages(**{name: name not in stage.needs for name in names})
    assert (stage in running(without)) == (not stage.needs)
    still = np.tile(np.eye(3), (6, 30, 1, 1))
    motion = HandleMotion(np.zeros((6, 30, 3)), still, np.zeros((6, 3)), still[:, 0])
    fitted = fit_motion(motion, reference_anatomy(), alone)
    np.testing.assert_allclose(fitted.transforms(reference_anatomy().handles.positions)[..., 3], 0, atol=2e-3)


def test_without_stages_a_motion_is_played_in_the_body_s_own_scale():
    still = np.tile(np.eye(3), (3, 30, 1, 1))
    motion = HandleMotion(np.zeros((3, 30, 3)), still, np.arange(9).reshape(3, 3), still[:, 0])
    fitting = Fitting.of(motion, reference_anatomy())
    np.testing.assert_allclose(fitting.motion.root_translation, motion.root_translation, atol=0.01)
    np.testing.assert_array_equal(fitting.moved(fitting.motion).motion.rotations, motion.rotations)


def test_what_was_made_for_a_kind_a_height_and_a_softness_is_looked_after_apart():
    dog = make_sample("dog", 0.3, rigged=True)
    anatomy = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    stages = {stage.name: stage for stage in STAGES}
    turns = np.tile(np.eye(3), (20, 30, 1, 1))
    shifts = np.zeros((20, 30, 3))
    shifts[:, HANDLE_NAMES.index("spine3")] = [0, 0.3, 0]
    sunk = np.tile([0, -0.2, 0], (20, 1))
    plain = HandleMotion(shifts, turns, sunk, turns[:, 0])
    for kind, height, soft in itertools.product((False, True), repeat=3):
        motion = replace(plain, own_kind=kind, own_height=height, soft=soft)
        fitting = Fitting.of(motion, anatomy)
        applied = [stages[name].applies(fitting, anatomy) for name in ("tail", "front", "level")]
        assert applied == [kind, kind, not kind]
        loose = stages["attach"](fitting, anatomy).translations[:, HANDLE_NAMES.index("spine3")]
        assert np.linalg.norm(loose, axis=1).max() == pytest.approx((0.3 if soft else 0.05) * anatomy.scale, rel=1e-3)
        low = fit_motion(motion, anatomy, Stages(smooth=False, feet=False, floor=False))
        assert (low.root_translation[:, 1].max() < -0.1 * anatomy.scale) == height  # others stand as the reference does
    own = plain.of_own_body()
    assert own.own_kind and own.own_height and own.soft and not own.of_own_body(False).soft
