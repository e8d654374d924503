"""Motions, paths over the ground, and animations that carry a rig."""

import numpy as np
import pytest
from oracles import skin_reference
from scipy.spatial.transform import Rotation

from bunraku import RigAnimation
from bunraku.core.animation import Animation, end_to_start
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, line_up, local_rotations
from bunraku.core.travel import GroundPath, bent_to_path
from bunraku.errors import CharacterError, MotionError, OptionError


def random_motion(frames=3, handles=4, seed=0):
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(frames * handles, random_state=seed).as_matrix().reshape(frames, handles, 3, 3)
    translations = rng.normal(size=(frames, handles, 3))
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    return HandleMotion(
        translations,
        rotations,
        rng.normal(size=(frames, 3)),
        Rotation.random(frames, random_state=seed + 1).as_matrix(),
    )


def test_driving_a_mesh_is_equation_3():
    rng = np.random.default_rng(1)
    motion = random_motion()
    vertices = rng.normal(size=(7, 3)).astype(np.float32)
    weights = rng.dirichlet(np.ones(4), size=7)
    h = rng.normal(size=(4, 3))
    character = Character("c", vertices, [[0, 1, 2], [3, 4, 5], [4, 5, 6]])
    got = Animation(character, Handles(h, weights), motion).vertices()
    for n in range(3):
        for i, v in enumerate(vertices.astype(float)):
            blend = sum(
                weights[i, k] * (motion.rotations[n, k].astype(float) @ (v - h[k]) + h[k] + motion.translations[n, k])
                for k in range(4)
            )
            want = motion.root_rotation[n] @ (blend - h[0]) + h[0] + motion.root_translation[n]
            np.testing.assert_allclose(got[n, i], want, atol=2e-5)


def test_what_was_taken_apart_is_joined_again():
    motion = random_motion(frames=5)
    again = HandleMotion.joined([motion.take(slice(0, 2)), motion.take(np.array([2])), motion.take(slice(3, None))])
    for name in HandleMotion.arrays:
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
    assert again.fps == motion.fps


@pytest.mark.parametrize("field", ["translations", "rotations", "root_translation"])
def test_motion_refuses_what_is_not_a_number(field):
    motion = random_motion()
    values = {
        name: getattr(motion, name).copy()
        for name in ("translations", "rotations", "root_translation", "root_rotation")
    }
    values[field][-1] = np.nan
    with pytest.raises(MotionError, match="not numbers"):
        HandleMotion(**values)


def test_local_rotations_are_the_way_back_of_forward_kinematics():
    skeleton = Skeleton(("a", "b", "c", "d"), [-1, 0, 1, 0], np.eye(4, 3))
    rotations = Rotation.random(8, random_state=3).as_matrix().reshape(2, 4, 3, 3)
    world, _ = SkeletalMotion(skeleton, rotations, np.zeros((2, 3))).world()
    np.testing.assert_allclose(local_rotations(world, skeleton.parents), rotations, atol=1e-6)
    assert line_up(2, skeleton.parents) == [2, 1, 0] and line_up(3, skeleton.parents) == [3, 0]


def test_skeleton_wants_parents_first():
    with pytest.raises(MotionError, match="parent before"):
        Skeleton(("a", "b"), [-1, 1], np.zeros((2, 3)))


def test_character_says_what_is_wrong():
    good = np.eye(3, dtype=np.float32)
    with pytest.raises(CharacterError, match="empty"):
        Character("x", np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(CharacterError, match="points without faces"):
        Character("x", good, np.zeros((0, 3)))
    with pytest.raises(CharacterError, match="only 3"):
        Character("x", good, [[0, 1, 3]])
    with pytest.raises(CharacterError, match="not numbers"):
        Character("x", good * np.nan, [[0, 1, 2]])
    with pytest.raises(CharacterError, match="one point"):
        Character("x", good * 0, [[0, 1, 2]])


def test_core_arrays_cannot_be_changed():
    vertices = np.eye(3, dtype=np.float32)
    character = Character("x", vertices, [[0, 1, 2]])
    with pytest.raises(ValueError, match="read-only"):
        character.vertices[0] = 1
    vertices[0, 0] = 2  # the caller's own array stays the caller's


def test_a_path_goes_through_its_points_from_the_first_to_the_last():
    path = GroundPath(((0, 0), (1, 2), (3, 2)))
    positions = path.positions(121, 20)
    np.testing.assert_allclose(positions[[0, -1]], [[0, 0], [3, 2]], atol=1e-6)
    assert np.linalg.norm(positions - [1, 2], axis=1).min() < 0.05
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) * 20
    assert speed[0] < 0.3 * speed.max() and speed[-1] < 0.3 * speed.max()
    assert np.abs(speed[20:100] - speed[20:100].mean()).max() < 0.25 * speed.mean()


def test_times_are_kept():
    path = GroundPath(((0, 0), (0, 1), (0, 4)), (0.0, 2.0, 3.0))
    np.testing.assert_allclose(path.positions(81, 20)[[0, 40, 60, 80]], [[0, 0], [0, 1], [0, 4], [0, 4]], atol=1e-6)
    with pytest.raises(OptionError, match="after the end"):
        path.positions(40, 20)


def test_who_walks_a_path_looks_along_it():
    path = GroundPath(((0, 0), (2, 0)))
    np.testing.assert_allclose(path.headings(41, 20), np.pi / 2, atol=1e-6)  # +X is a quarter turn from +Z
    np.testing.assert_allclose(path.headings(41, 20, backwards=True), 1.5 * np.pi, atol=1e-6)


@pytest.mark.parametrize(
    "values",
    [((),), (((0, 0),),), (((0, 0), (0, 0)),), (((0, 0), (0, float("inf"))),), (((0, 0), (0, 9999)),),
     (((0, 0), (0, 1)), (0.0,)), (((0, 0), (0, 1)), (1.0, 2.0)), (((0, 0), (0, 1), (0, 2)), (0.0, 2.0, 2.0))],
)  # fmt: skip
def test_paths_that_are_none(values):
    with pytest.raises(OptionError):
        GroundPath(*values)


def test_a_root_is_brought_to_its_path_and_keeps_its_sway():
    frames, path = 100, GroundPath(((0, 0), (0, 4)))
    root = np.zeros((frames, 3))
    root[:, 0] = 0.3 + 0.02 * np.sin(np.arange(frames) * 1.5)
    motion = HandleMotion(np.zeros((frames, 2, 3)), np.broadcast_to(np.eye(3), (frames, 2, 3, 3)), root,
                          np.broadcast_to(np.eye(3), (frames, 3, 3)))  # fmt: skip
    found = bent_to_path(motion, path).root_translation
    off = found[:, [0, 2]] - path.positions(frames, 20)
    assert np.linalg.norm(off, axis=1).max() < 0.05
    assert np.ptp(off[20:80, 0]) > 0.02


@pytest.fixture(scope="module")
def character():
    return reference_body().character()


def swinging(character, frames=3, seed=0):
    random = np.random.default_rng(seed)
    bones = len(character.rig.names)
    turns = matrix_from_axis_angle(0.5 * random.normal(size=(frames, bones, 3)))
    return RigAnimation(character, turns, 0.05 * random.normal(size=(frames, bones, 3)), 20.0)


def test_world_and_back(character):
    animation = swinging(character)
    again = RigAnimation.of_world(character, *animation.world(), 20.0)
    assert np.abs(again.rotations - animation.rotations).max() < 1e-6
    assert np.abs(again.translations - animation.translations).max() < 1e-6


def test_vertices_are_those_of_linear_blend_skinning(character):
    animation = swinging(character)
    want = skin_reference(character.vertices, character.rig.dense_weights(), animation.transforms())
    assert np.abs(animation.vertices() - want).max() < 1e-5
    assert np.abs(animation.animation().vertices([2]) - want[2:]).max() < 1e-5


def test_what_is_no_animation_is_refused(character):
    bones = len(character.rig.names)
    with pytest.raises(MotionError, match="shape"):
        RigAnimation(character, np.zeros((2, bones - 1, 3, 3)), np.zeros((2, bones, 3)))
    with pytest.raises(MotionError, match="not numbers"):
        RigAnimation(character, np.full((2, bones, 3, 3), np.nan), np.zeros((2, bones, 3)))
    with pytest.raises(MotionError, match="at least one frame"):
        RigAnimation(character, np.zeros((0, bones, 3, 3)), np.zeros((0, bones, 3)))
    with pytest.raises(CharacterError, match="no rig"):
        RigAnimation(
            Character("bare", character.vertices, character.faces), np.zeros((2, bones, 3, 3)), np.zeros((2, bones, 3))
        )


FPS = 20.0


def walking(character, way, turn, frames=21):
    """One that goes a way [m] with an arm that swings, and turns about +Y [rad]."""
    turns, moves = np.zeros((frames, 22, 3)), np.zeros((frames, 22, 3))
    share = np.linspace(0, 1, frames)[:, None]
    turns[:, JOINT_NAMES.index("left_shoulder"), 0] = np.sin(3 * share[:, 0])
    turns[:, 0, 1] = turn * share[:, 0]
    moves[:, 0] = share * way
    return RigAnimation(character, matrix_from_axis_angle(turns), moves, FPS)


def test_each_goes_on_where_the_one_before_ends():
    body = reference_body().character()
    first, second = walking(body, [0, 0, 2], np.pi / 2), walking(body, [0, 0, 1], 0.0)
    whole = end_to_start([first, second])
    assert len(whole) == len(first) + len(second) - 1
    places = whole.world()[1]
    assert np.abs(places[: len(first)] - first.world()[1]).max() < 1e-5
    # A quarter to the left, so the second one's way along +Z is along +X.
    assert np.allclose(places[-1, 0] - places[len(first) - 1, 0], [1, 0, 0], atol=1e-3)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1).max(axis=1)
    assert steps[len(first) - 2 : len(first) + 8].max() < 2.0 * steps[: len(first) - 1].max()
