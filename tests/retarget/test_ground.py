"""Standing on the ground: sliding feet, soles, and the support of four-legged bodies."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE_FACES
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy, decimated, reference_anatomy
from bunraku.anatomy.joints import find_joints, reference_joints
from bunraku.anatomy.legs import find_legs
from bunraku.anatomy.rest_pose import upright
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.stages.feet import Feet
from bunraku.retarget.stages.ground import Ground, Soles, enough
from bunraku.retarget.stages.shape import Smooth
from bunraku.retarget.stages.stage import sole_points, with_feet_moved
from bunraku_lab.datasets.motions.build import handle_motion_of_body
from bunraku_lab.datasets.motions.clips import load_clip

LEFT, RIGHT = HANDLE_NAMES.index("left_hip"), HANDLE_NAMES.index("right_hip")


@pytest.fixture(scope="module")
def person():
    body = reference_body()
    character, joints = body.character(), reference_joints()
    return character, body.handles, joints, find_legs(character, body.handles, joints, True)


def still(frames=30):
    """The reference body in its rest pose."""
    shape = (frames, HANDLE_COUNT)
    return HandleMotion(
        np.zeros((*shape, 3)),
        np.tile(np.eye(3), (*shape, 1, 1)),
        np.zeros((frames, 3)),
        np.tile(np.eye(3), (frames, 1, 1)),
    )


def posed(frames, axis=(1, 0, 0), **angles):
    """Joints turned about an axis by so many degrees, each a number or one for every frame; the lowest point of all
    frames is on the ground.
    """
    body = reference_body()
    rotations = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    for name, degrees in angles.items():
        turn = np.radians(np.broadcast_to(degrees, frames))[:, None] * axis
        rotations[:, JOINT_NAMES.index(name)] = Rotation.from_rotvec(turn).as_matrix()
    motion = handle_motion_of_body(SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (frames, 1))))
    lowest = Animation(body.character(), body.handles, motion).vertices()[..., 1].min()
    return replace(motion, root_translation=motion.root_translation - [0, lowest, 0])


def soles(motion, person):
    _, handles, _, legs = person
    transforms = motion.transforms(handles.positions)
    return [sole_points(leg, reference_anatomy(), transforms) for leg in legs]


def table():
    """A body with a head on four legs of three boxes each, of which two are arms to the handles."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (0, 1) for z in (-0.5, 0.5)])
    boxes = [("pelvis", (0, 0.9, 0), (0.5, 0.3, 1)), ("head", (0, 1, 0.7), (0.3, 0.3, 0.4))]
    for side, x in (("left", 0.2), ("right", -0.2)):
        for parts, z in ((("hip", "knee", "ankle"), -0.4), (("shoulder", "elbow", "wrist"), 0.4)):
            boxes += [
                (f"{side}_{part}", (x, y, z), (0.1, 0.3, 0.1)) for part, y in zip(parts, (0.6, 0.3, 0), strict=True)
            ]
    vertices = np.concatenate([corners * size + position for _, position, size in boxes])
    faces = np.concatenate([CUBE_FACES + 8 * number for number in range(len(boxes))])
    weights = np.zeros((len(vertices), HANDLE_COUNT))
    weights[np.arange(len(vertices)), np.repeat([HANDLE_NAMES.index(name) for name, _, _ in boxes], 8)] = 1
    areas = vertex_areas(vertices, faces)
    return Character("table", vertices, faces), Handles(handle_positions(vertices, weights, areas), weights)


def test_who_lies_along_its_spine_stands_on_all_that_reaches_the_ground():
    character, handles = table()
    legs = find_legs(character, handles, find_joints(character, handles), upright(handles))
    assert [HANDLE_NAMES[leg.upper] for leg in legs] == ["left_hip", "right_hip", "left_shoulder", "right_shoulder"]
    for leg in legs:
        np.testing.assert_allclose(leg.joints[:, 1], [0.9, 0.6, 0.3], atol=0.01)
        assert leg.length == pytest.approx(0.9, abs=0.05)
    short = Character(
        "armed",
        np.where(
            np.isin(np.arange(len(character.vertices)) // 8, [7, 13])[:, None], [0.5, 0.9, 0.5], character.vertices
        ),
        character.faces,
    )
    assert (
        len(find_legs(short, handles, find_joints(short, handles), upright(handles))) == 2
    )  # front legs that do not reach the ground are arms


def test_who_has_no_legs_is_lifted_and_otherwise_left_alone():
    body = reference_body()
    weights = body.handle_weights.copy()
    legs = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
    weights[:, 0] += weights[:, legs].sum(axis=1)
    weights[:, legs] = 0
    ghost, handles = body.character(), Handles(body.handles.positions, weights)
    assert Anatomy.of(ghost, handles).legs == []
    motion = replace(still(20), root_translation=np.linspace(0, 1, 20)[:, None] * [0.3, 0, 0])
    with_stage, without = (fit_motion(motion, Anatomy.of(ghost, handles), Stages(feet=feet)) for feet in (True, False))
    np.testing.assert_array_equal(with_stage.root_translation, without.root_translation)


def test_a_moved_foot_is_where_it_should_be_and_bones_keep_their_length(person):
    _, handles, _, legs = person
    motion = posed(5, left_hip=-40, left_knee=60)
    shift = np.zeros((5, 2, 3))
    shift[:, 0] = [0.05, 0.08, -0.1]
    moved = with_feet_moved(motion, reference_anatomy(), legs, shift)
    before, after = soles(motion, person), soles(moved, person)
    np.testing.assert_allclose(
        after[0] - before[0], np.broadcast_to(shift[:, :1], after[0].shape), atol=0.01
    )  # some of the sole is the shin's
    np.testing.assert_allclose(np.median(after[0] - before[0], axis=1), shift[:, 0], atol=0.001)
    np.testing.assert_allclose(after[1], before[1], atol=1e-6)

    def joint(motion, handle, position):
        transform = motion.transforms(handles.positions)[:, handle]
        return transform[..., :3] @ position + transform[..., 3]

    for upper, lower, position in (
        (legs[0].upper, legs[0].lower, legs[0].joints[1]),
        (legs[0].lower, legs[0].end, legs[0].joints[2]),
    ):
        gaps = [
            np.linalg.norm(joint(some, upper, position) - joint(some, lower, position), axis=1)
            for some in (motion, moved)
        ]
        np.testing.assert_allclose(gaps[1], gaps[0], atol=2e-4)  # still joined as they were
    np.testing.assert_allclose(
        joint(moved, legs[0].upper, legs[0].joints[0]), joint(motion, legs[0].upper, legs[0].joints[0]), atol=1e-5
    )
    for rotation in moved.rotations[:, [legs[0].upper, legs[0].lower]].reshape(-1, 3, 3):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)


def test_a_path_that_disagrees_with_standing_feet_is_corrected(person):
    motion = still(40)
    path = np.linspace(0, 1, 40)[:, None] * [0.5, 0, 0.8]  # slides at half a metre a second
    slid, contacts = Feet().locked(replace(motion, root_translation=path), reference_anatomy())
    assert contacts.stands.min() > 0.9
    way = np.linalg.norm(np.diff(soles(slid, person)[0][:, :, [0, 2]], axis=0), axis=-1)
    assert way.mean() < 0.002 < 0.02 < np.linalg.norm(np.diff(path, axis=0), axis=1).mean()


def test_one_foot_that_stands_keeps_the_body_while_the_other_swings(person):
    motion = posed(30, left_hip=-40 + 40 * np.cos(np.linspace(0, 4 * np.pi, 30)), left_knee=60)
    after, contacts = Feet().locked(motion, reference_anatomy())
    assert contacts.stands[:, 0].mean() < 0.2 < 0.9 < contacts.stands[:, 1].mean()
    assert np.abs(after.root_translation - motion.root_translation).max() < 0.01
    np.testing.assert_allclose(soles(after, person)[0], soles(motion, person)[0], atol=0.04)


def test_feet_that_jump_apart_and_back_again_go_all_the_way(person):
    """A jumping jack so low that the soles hardly leave the ground: two feet whose distance changes do not both stand,
    and at the ends of their way they do. Where both might, two thirds of the way are left.
    """
    angle = 9 - 9 * np.cos(np.arange(44) * 2 * np.pi / 20)  # out and back in a second
    motion = posed(44, (0, 0, 1), left_hip=angle, right_hip=-angle)
    lift = 0.01 - np.minimum(*(points[..., 1].min(axis=1) for points in soles(motion, person)))
    motion = replace(motion, root_translation=motion.root_translation + lift[:, None] * [0, 1, 0])

    def apart(motion):
        left, right = (points[..., 0].mean(axis=1) for points in soles(motion, person))
        return np.ptp(np.abs(left - right))

    after, contacts = Feet().locked(motion, reference_anatomy())
    assert apart(motion) > 0.4 and apart(after) > 0.75 * apart(motion)
    assert contacts.stands.max() > 0.9


def test_nobody_stands_on_the_feet_when_kneeling():
    motion = posed(20, left_knee=100, right_knee=100)
    contacts, missing = Feet().contacts(
        replace(motion, root_translation=motion.root_translation + np.arange(20)[:, None] * [0, 0, 0.01]),
        reference_anatomy(),
    )
    assert contacts.stands.max() == 0
    assert np.abs(missing).max() < 1e-9


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_the_shortest_clips_are_fitted_too(frames):
    body = reference_body()
    assert len(fit_motion(still(frames), Anatomy.of(body.character(), body.handles))) == frames


def test_a_lift_is_enough_and_smooth():
    need = np.zeros(60)
    need[30] = 1.0
    lift = enough(need, 3)
    assert (lift >= need - 1e-12).all()
    assert np.abs(np.diff(lift)).max() < 0.5
    assert lift[:20].max() == 0
    np.testing.assert_array_equal(enough(np.zeros(5), 3), 0)


def test_what_sinks_is_lifted_and_only_with_the_stage():
    body = reference_body()
    character = body.character()
    wave = 0.1 * np.sin(np.linspace(0, 12, 60))  # the generator's heights are off by more than `ground` evens out
    motion = replace(
        posed(60, left_hip=-30 + 20 * np.sin(np.linspace(0, 9, 60)), left_knee=40),
        root_translation=wave[:, None] * [0, 1, 0],
    )

    def deepest(stages):
        return (
            -Animation(character, body.handles, fit_motion(motion, Anatomy.of(character, body.handles), stages))
            .vertices()[..., 1]
            .min()
            / character.height
        )

    assert deepest(Stages()) < 0.005
    assert deepest(Stages(ground=False, floor=False, feet=False)) > 0.02 > 0.005 > deepest(Stages(ground=False))


def test_jitter_goes_and_hits_stay():
    rng = np.random.default_rng(0)
    frames = 80
    clean = posed(
        frames, right_elbow=np.where((np.arange(frames) > 40) & (np.arange(frames) < 44), 90.0, 0.0)
    )  # as quick as frames can hold

    def noisy(motion, size):
        turns = (
            Rotation.from_rotvec(size * rng.normal(size=(frames * HANDLE_COUNT, 3)))
            .as_matrix()
            .reshape(frames, HANDLE_COUNT, 3, 3)
        )
        turns[:, 0] = np.eye(3)
        return replace(motion, rotations=motion.rotations @ turns)

    def shake(motion, handle):
        return np.abs(np.diff(motion.rotations[:35, handle].astype(float), 3, axis=0)).mean()

    elbow = HANDLE_NAMES.index("right_elbow")
    dirty = noisy(clean, 0.001)
    assert shake(Smooth().smoothed(dirty), LEFT) < 0.5 * shake(dirty, LEFT)

    def speed(motion):
        return np.abs(np.diff(motion.rotations[:, elbow].astype(float), axis=0)).max()

    assert speed(Smooth().smoothed(dirty)) > 0.95 * speed(clean)
    np.testing.assert_allclose(
        Smooth().smoothed(clean).rotations, clean.rotations, atol=1e-5
    )  # without noise there is none to take out


def test_a_lighter_mesh_gives_the_same_motion(monkeypatch):
    trimesh = pytest.importorskip("trimesh")
    body = reference_body()
    vertices, faces, rows = trimesh.remesh.subdivide(
        body.vertices, body.faces, vertex_attributes={"weights": body.handle_weights}
    )
    character = Character("fine", vertices, faces)
    handles = Handles(body.handles.positions, rows["weights"] / rows["weights"].sum(axis=1, keepdims=True))
    assert decimated(character, handles)[0] is character  # few enough
    motion = posed(20, left_hip=-30 + 20 * np.sin(np.linspace(0, 9, 20)), left_knee=40)
    full, joints = fit_motion(motion, Anatomy.of(character, handles)), Anatomy.of(character, handles).joints
    monkeypatch.setattr("bunraku.anatomy.anatomy.MANY", 8000)
    monkeypatch.setattr("bunraku.anatomy.anatomy.CELLS", 4000)
    light, lighter_handles = decimated(character, handles)
    assert len(light.vertices) < 0.7 * len(character.vertices)
    fast, found = fit_motion(motion, Anatomy.of(character, handles)), Anatomy.of(light, lighter_handles).joints
    assert (found.present == joints.present).all()
    assert np.linalg.norm(found.positions - joints.positions, axis=1)[joints.present].max() < 0.004 * character.height
    away = np.linalg.norm(
        np.diff([Animation(character, handles, some).vertices() for some in (full, fast)], axis=0), axis=-1
    )
    assert away.mean() < 0.003 * character.height
    assert away.max() < 0.01 * character.height


def test_what_hovers_is_set_down_and_what_jumps_or_flies_is_not():
    frames = 100
    height = np.full(frames, 0.06)
    height[40:50] += 0.3 * np.sin(np.linspace(0, np.pi, 10))
    path = np.zeros((frames, 3))
    path[:, 1] = height
    still = np.tile(np.eye(3), (frames, 30, 1, 1))
    motion = HandleMotion(np.zeros((frames, 30, 3)), still, path, np.tile(np.eye(3), (frames, 1, 1)), 20.0)
    settled = Ground().grounded(motion, reference_anatomy()).root_translation[:, 1]
    assert np.abs(np.delete(settled, np.arange(40, 50))).max() < 0.01
    assert settled[40:50].max() == pytest.approx(0.3, abs=0.03)
    flying = replace(motion, root_translation=path + [0, 0.5, 0])
    np.testing.assert_allclose(
        Ground().grounded(flying, reference_anatomy()).root_translation[:, 1], height + 0.5, atol=1e-6
    )
    grounded = Ground().grounded(flying, reference_anatomy(), flies=False).root_translation[:, 1]
    assert np.abs(np.delete(grounded, np.arange(40, 50))).max() < 0.01


def bowed(frames, lift):
    """Somebody who bows so deeply for a second that the stretched hands go under the ground; the feet stay on it."""
    body = reference_body()
    share = np.sin(np.clip(np.linspace(-0.5, 1.5, frames), 0, 1) * np.pi)[:, None]
    rotations = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    rotations[:, JOINT_NAMES.index("spine1")] = Rotation.from_rotvec(np.radians(160) * share * [1, 0, 0]).as_matrix()
    for side, turn in (("left", -90), ("right", 90)):
        ahead = Rotation.from_euler("yx", [turn, -70], degrees=True).as_rotvec()
        rotations[:, JOINT_NAMES.index(f"{side}_shoulder")] = Rotation.from_rotvec(share * ahead).as_matrix()
    motion = handle_motion_of_body(SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (frames, 1))))
    return replace(motion, root_translation=motion.root_translation + [0, lift, 0])


@pytest.mark.parametrize("lift", [0.0, 0.12])
def test_hands_under_the_ground_lift_no_feet(person, lift):
    motion = bowed(60, lift)
    character, handles = person[:2]
    stood = soles(motion, person)[0][..., 1].min()
    assert Animation(character, handles, motion).vertices()[..., 1].min() < stood - 0.05  # the hands
    fitted = fit_motion(motion, reference_anatomy())
    heights = [points[..., 1].min(axis=1) for points in soles(fitted, person)]
    assert np.abs(heights).max() < 0.02
    assert Animation(character, handles, fitted).vertices()[..., 1].min() > -0.01


def test_who_stands_on_the_hands_is_not_let_down_to_the_head(person):
    upside_down = np.tile(np.diag([1.0, -1, -1]), (80, 1, 1))
    body = reference_body()
    skeletal = np.tile(np.eye(3), (80, JOINT_COUNT, 1, 1))
    skeletal[:, 0] = upside_down
    for name, degrees in (("left_shoulder", 90), ("right_shoulder", -90)):
        skeletal[:, JOINT_NAMES.index(name)] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    motion = handle_motion_of_body(SkeletalMotion(body.skeleton, skeletal, np.tile(body.joints[0], (80, 1))))
    lowest = Animation(body.character(), body.handles, motion).vertices()[..., 1].min()
    motion = replace(motion, root_translation=motion.root_translation - [0, lowest, 0])
    fitted = fit_motion(motion, reference_anatomy())
    found = Animation(person[0], person[1], fitted).vertices()[40]
    assert abs(found[:, 1].min()) < 0.02
    head = person[1].weights[:, HANDLE_NAMES.index("head")] > 0.5
    before = Animation(person[0], person[1], motion).vertices()[40]
    assert found[head, 1].min() == pytest.approx(before[head, 1].min(), abs=0.02)


DATA = Path(os.environ.get("BUNRAKU_DATA", "runs/data"), "motions")


@pytest.mark.parametrize(("name", "share"), [("cmu_02_06", 0.01), ("snu_Physics_Raise01", 0.06), ("cmu_140_03", 0.06)])
def test_who_scoops_or_lies_is_on_the_ground(person, name, share):
    """A scooping figure hovered by 17 cm, and those who lie began 35 cm in the air."""
    path = DATA / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"{name} was not built into {DATA}")
    motion = load_clip(path)
    fitted = fit_motion(motion, reference_anatomy())
    lowest = Animation(person[0], person[1], fitted).vertices()[..., 1].min(axis=1)
    assert np.percentile(lowest, 95) < share * person[0].height
    assert lowest[0] < 0.02 and lowest.min() > -0.02


H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
FRAMES, MIDDLE = 41, 20


def footed(longer: float) -> Anatomy:
    """The reference body with feet that reach so many times as far from their ankles."""
    body = reference_body()
    vertices = body.vertices.astype(np.float64).copy()
    for side in ("left", "right"):
        foot = body.handle_weights[:, [H[f"{side}_ankle"], H[f"{side}_foot"]]].sum(axis=1) > 0.5
        ankle = body.joints[H[f"{side}_ankle"]]
        vertices[foot, 2] = ankle[2] + longer * (vertices[foot, 2] - ankle[2])
    character = Character("footed", vertices, body.faces)
    weights = body.handle_weights
    return Anatomy.of(character, Handles(handle_positions(vertices, weights, character.areas), weights))


def tiptoeing() -> HandleMotion:
    """Both feet point down by 35 degrees in the middle, while the body is as high as a person's toes need."""
    angle = np.radians(35) * np.exp(-(((np.arange(FRAMES) - MIDDLE) / 4.0) ** 2))
    rotations = np.tile(np.eye(3), (FRAMES, HANDLE_COUNT, 1, 1))
    for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"):
        rotations[:, H[name]] = matrix_from_axis_angle(angle[:, None] * np.array([1.0, 0, 0]))
    path = np.zeros((FRAMES, 3))
    path[:, 1] = 0.18 * np.sin(angle)
    return HandleMotion(
        np.zeros((FRAMES, HANDLE_COUNT, 3)), rotations, path, np.tile(np.eye(3), (FRAMES, 1, 1)), own_height=True
    )


def slopes(motion: HandleMotion) -> np.ndarray:
    """How far the left foot points down in each frame [degrees]."""
    return np.degrees(np.arcsin(np.clip(-motion.rotations[:, H["left_ankle"], 1, 2], -1, 1)))


def test_long_feet_are_held_flatter_and_do_not_sink():
    anatomy = footed(2.5)
    off = fit_motion(tiptoeing(), anatomy, replace(Stages(), soles=False, feet=False, floor=False))
    on = Soles().changed(off, anatomy)
    assert slopes(off)[MIDDLE] == pytest.approx(35, abs=3)
    assert slopes(on)[MIDDLE] < 22
    leg = anatomy.legs[0]
    for motion, sunk in ((off, True), (on, False)):
        world = motion.transforms(anatomy.handles.positions)
        low = sole_points(leg, anatomy, world)[..., 1].min() - anatomy.floor
        assert (low < -1.05 * Soles().sinks * leg.length) == sunk
    np.testing.assert_array_equal(on.root_translation, off.root_translation)
