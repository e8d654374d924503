"""The humanoid skeleton of an animation: it turns as the motion it plays, and its joints are where the mesh's are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import JOINT_COUNT
from bunraku.body.reference import handle_positions, leg_length, reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import MotionError
from bunraku.geometry.surface import vertex_areas
from bunraku.handles.from_rig import rig_handles
from bunraku.io.humanoid import humanoid_motion
from bunraku.io.motions import load_motion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.from_mesh import handle_motion_of_body
from bunraku_lab.synthetic.samples import make_sample


def degrees(a, b):
    turns = np.swapaxes(a, -1, -2).astype(float) @ b
    return np.degrees(Rotation.from_matrix(turns.reshape(-1, 3, 3)).magnitude()).reshape(turns.shape[:-2])


@pytest.fixture(scope="module")
def source():
    """Arms and legs swing, the body turns."""
    time = np.linspace(0, 2, 20)
    turns = np.tile(np.eye(3), (20, JOINT_COUNT, 1, 1))
    for joint, axis in (
        (1, [0.5, 0, 0]),
        (2, [-0.5, 0, 0]),
        (4, [0.4, 0, 0]),
        (16, [0, 0, -0.9]),
        (17, [0, 0.5, 0.9]),
        (18, [0, -0.8, 0]),
        (6, [0, 0.3, 0]),
    ):
        turns[:, joint] = Rotation.from_rotvec(np.sin(2 * time)[:, None] ** 2 * axis).as_matrix()
    turns[:, 0] = Rotation.from_rotvec(time[:, None] * [0, 0.6, 0]).as_matrix()
    return SkeletalMotion(reference_body().skeleton, turns, np.stack([0 * time, 1.015 + 0 * time, time], -1), 20.0)


@pytest.fixture(scope="module")
def child(source):
    """A smaller body in an A-pose, with the motion fitted to it."""
    body, size = reference_body(), 0.6
    down = np.tile(np.eye(3), (1, JOINT_COUNT, 1, 1))
    for joint, turn in ((16, -0.7), (17, 0.7)):
        down[:, joint] = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    vertices = size * body.pose(SkeletalMotion(body.skeleton, down, body.joints[:1], 20.0))[0]
    character = Character("child", vertices, body.faces)
    positions = handle_positions(vertices, body.handle_weights, vertex_areas(vertices, body.faces))
    handles = Handles(positions, body.handle_weights)
    fitted = fit_motion(
        handle_motion_of_body(source),
        Anatomy.of(character, handles),
        Stages(smooth=False, feet=False, floor=False, ground=False),
    )
    return Animation(character, handles, fitted)


def test_it_turns_as_the_motion_that_was_fitted(source, child):
    found = humanoid_motion(child)
    assert degrees(found.world()[0], source.world()[0]).mean() < 3


def test_it_has_the_characters_size(child):
    found, body = humanoid_motion(child), reference_body()
    assert leg_length(found.skeleton.positions) == pytest.approx(0.6 * leg_length(body.joints), rel=0.05)
    arms = found.skeleton.positions[18] - found.skeleton.positions[16]
    assert arms[0] > 0.98 * np.linalg.norm(arms)  # the rest pose is the T-pose, whatever the character's is


def test_joints_are_in_the_limbs(source, child):
    found = humanoid_motion(child)
    positions, posed = found.world()[1], child.vertices()
    for joint in (4, 5, 7, 8, 18, 19):
        own = child.handles.weights[:, joint] > 0.2
        gap = np.linalg.norm(posed[:, own] - positions[:, None, joint], axis=-1).min(axis=1)
        assert gap.max() < 0.08 * child.character.height


@pytest.mark.parametrize("suffix", ["bvh", "vrma"])
def test_an_animation_is_saved_as_it(child, tmp_path, suffix):
    read = load_motion(child.save(tmp_path / f"swing.{suffix}", fps=40))
    found = humanoid_motion(child)
    assert read.fps == pytest.approx(40) and len(read) == 39
    assert np.abs(read.root_translation[::2] - found.root_translation).max() < 1e-4


def test_a_creature_has_one_too(source):
    dog = make_sample("dog", 0.3, rigged=True)
    handles = rig_handles(dog)
    found = humanoid_motion(
        Animation(dog, handles, fit_motion(handle_motion_of_body(source), Anatomy.of(dog, handles)))
    )
    assert np.isfinite(found.world()[1]).all() and np.ptp(found.skeleton.positions, axis=0).max() < 3 * dog.height


def test_other_handles_are_refused():
    body = reference_body()
    weights = np.eye(3, dtype=np.float32)[np.arange(len(body.vertices)) % 3]
    still = HandleMotion(
        np.zeros((2, 3, 3)), np.tile(np.eye(3), (2, 3, 1, 1)), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    )
    with pytest.raises(MotionError, match="this animation has 3"):
        humanoid_motion(Animation(body.character(), Handles(np.zeros((3, 3)), weights), still))
