"""Handle motion against Eq. 3 written out, and the rules of the core types."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles, Rig, top_influences
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, line_up, local_rotations
from bunraku.errors import CharacterError, MotionError


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


def test_handle_0_must_not_move_locally():
    motion = random_motion()
    moved = motion.translations.copy()
    moved[0, 0] = 0.1
    with pytest.raises(MotionError, match="handle 0"):
        HandleMotion(moved, motion.rotations, motion.root_translation, motion.root_rotation)


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


def test_forward_kinematics_by_hand():
    skeleton = Skeleton(("a", "b", "c"), [-1, 0, 1], [[0, 0, 0], [0, 1, 0], [0, 1, 0]])
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    motion = SkeletalMotion(skeleton, [[quarter, quarter, np.eye(3)]], [[5, 0, 0]])
    rotations, positions = motion.world()
    np.testing.assert_allclose(positions[0], [[5, 0, 0], [4, 0, 0], [4, -1, 0]], atol=1e-6)
    np.testing.assert_allclose(rotations[0, 2], quarter @ quarter, atol=1e-6)


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


def test_top_influences_by_hand():
    indices, shares = top_influences(np.array([[0.1, 0.4, 0.2, 0.05, 0.25]]), 2)
    assert indices.tolist() == [[1, 4]]
    np.testing.assert_allclose(shares, [[0.4 / 0.65, 0.25 / 0.65]], rtol=1e-6)


def test_rig_weights_as_a_matrix():
    rig = Rig(("a", "b", "c"), [-1, 0, 0], np.tile(np.eye(4), (3, 1, 1)), [[2, 0], [1, 1]], [[0.75, 0.25], [0.5, 0.5]])
    np.testing.assert_allclose(rig.dense_weights(), [[0.25, 0, 0.75], [0, 1, 0]])
    with pytest.raises(CharacterError, match="joint that does not exist"):
        Rig(("a",), [-1], np.eye(4)[None], [[1]], [[1.0]])
