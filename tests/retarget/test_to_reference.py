"""Motion of rigs on the reference body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import reference_joints
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT
from bunraku.core.body.reference import handle_positions, leg_length, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.pipelines.humanoid import humanoid_motion
from bunraku.pipelines.to_reference import load_motion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.to_reference import motion_to_reference
from bunraku_lab.datasets.motions.build import handle_motion_of_body
from bunraku_lab.synthetic.samples import make_sample

BARE = Stages(leap=False, feet=False, smooth=False, floor=False, hands_clear=False)
"""What carries a motion over, without what corrects it."""


def beast(name):
    character = make_sample(name, 0.3, rigged=True)
    return character, rig_handles(character)


def wild(height, frames=12, seed=0):
    """Every handle turns and leaves its joint a little; the body rises, tilts and turns round."""
    random = np.random.default_rng(seed)
    phase = np.linspace(0, 2 * np.pi, frames)[:, None, None]
    turns = 0.6 * np.sin(phase + random.uniform(0, 6, (1, 30, 1))) * random.normal(size=(1, 30, 3))
    rotations = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(frames, 30, 3, 3)
    translations = 0.02 * height * np.cos(phase) * random.normal(size=(1, 30, 3))
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    path = height * np.stack([np.sin(phase[:, 0, 0]), 2 + np.cos(phase[:, 0, 0]), phase[:, 0, 0]], axis=1)
    root = Rotation.from_euler(
        "YXZ", np.stack([phase[:, 0, 0], 0.5 * np.sin(phase[:, 0, 0]), phase[:, 0, 0] / 3], axis=1)
    ).as_matrix()
    return HandleMotion(translations, rotations, path, root)


@pytest.mark.parametrize("name", ["dog", "dragon", "mushroom", "person"])
def test_there_and_back_is_the_same_clip(name):
    character, handles = beast(name)
    here = wild(character.height)
    # what hangs on joints: the wild translations on top of those that keep parts together
    anatomy = Anatomy.of(character, handles)
    there = motion_to_reference(here, anatomy, own=True)
    again = motion_to_reference(fit_motion(there.of_own_body(), anatomy, BARE), anatomy, own=True)
    first, second = (
        Animation(character, handles, fit_motion(m.of_own_body(), anatomy, BARE)).vertices() for m in (there, again)
    )
    assert np.linalg.norm(first - second, axis=-1).max() < 1e-3 * character.height


@pytest.mark.parametrize("name", ["dog", "dragon"])
def test_a_clip_whose_parts_hold_together_comes_back(name):
    character, handles = beast(name)
    clip = fit_motion(
        motion_to_reference(wild(character.height), Anatomy.of(character, handles), own=True).of_own_body(),
        Anatomy.of(character, handles),
        BARE,
    )
    back = fit_motion(
        motion_to_reference(clip, Anatomy.of(character, handles), own=True).of_own_body(),
        Anatomy.of(character, handles),
        BARE,
    )
    want, got = (Animation(character, handles, motion).vertices() for motion in (clip, back))
    assert np.linalg.norm(got - want, axis=-1).max() < 1e-3 * character.height


def test_tail_and_height_stay_the_creatures():
    character, handles = beast("dog")
    still = np.broadcast_to(np.eye(3), (5, 30, 3, 3)).copy()
    tail = HANDLE_NAMES.index("tail")
    still[:, tail] = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    path = np.tile([0, 0.5 * character.height, 0], (5, 1))
    clip = HandleMotion(np.zeros((5, 30, 3)), still, path, np.broadcast_to(np.eye(3), (5, 3, 3)))
    native = motion_to_reference(clip, Anatomy.of(character, handles), own=True)
    person = motion_to_reference(clip, Anatomy.of(character, handles))
    assert Rotation.from_matrix(native.rotations[0, tail]).magnitude() == pytest.approx(np.radians(40), abs=1e-3)
    assert native.root_translation[:, 1].min() > 0.2
    np.testing.assert_allclose(person.rotations[:, tail], np.eye(3)[None].repeat(5, 0), atol=1e-6)
    body = reference_body()
    assert abs(Animation(body.character(), body.handles, person).vertices()[..., 1].min()) < 0.02


def test_parts_that_a_creature_lacks_move_with_their_parents():
    character, handles = beast("mushroom")
    anatomy = Anatomy.of(character, handles)
    there = motion_to_reference(wild(character.height), anatomy, own=True)
    absent = [k for k in range(1, 30) if not anatomy.joints.present[k]]
    assert absent
    for handle in absent:
        np.testing.assert_allclose(
            there.rotations[:, handle], there.rotations[:, max(int(anatomy.joints.parents[handle]), 0)], atol=1e-5
        )
    assert np.abs(there.translations).max() < 3 and np.isfinite(there.translations).all()
    assert reference_joints().present.sum() > 20


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
