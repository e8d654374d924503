"""The stages of rest pose and shape: unusual bodies, fins, stumps, and the front."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles import skin_reference
from scipy.optimize import minimize

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints, attach_joints
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.locomotion import moved_so
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.animals import Front
from bunraku.retarget.stages.rest_pose import Fins
from bunraku.retarget.stages.shape import Shape
from bunraku_lab.synthetic.samples import make_sample


def _bar(smooth: bool = True) -> tuple[Character, Handles]:
    """A flat bar along x with the root's handle at 0, one at its left and one at its right end."""
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.1, 0.1, 3))
    vertices = np.stack([x.ravel(), y.ravel(), 0.01 * np.cos(7 * x.ravel())], axis=1)
    corner = (np.arange(2)[:, None] * 17 + np.arange(16)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 18], 1), np.stack([corner, corner + 18, corner + 17], 1)]
    )
    right = np.clip(0.5 + x.ravel() / 0.4, 0, 1) if smooth else (x.ravel() > 0).astype(float)
    weights = np.stack([np.zeros_like(right), 1 - right, right], axis=1)
    positions = np.array([[0, 0, 0], [-0.4, 0, 0], [0.4, 0, 0.0]])
    return Character("bar", vertices, faces), Handles(positions, weights)


def _pose(frames: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """The right half turns about z, and its handle is pulled away."""
    rotations = np.tile(np.eye(3), (frames, 3, 1, 1))
    rotations[:, 2] = matrix_from_axis_angle(np.linspace(0, 1.2, frames)[:, None] * [0, 0, 1.0])
    translations = np.zeros((frames, 3, 3))
    translations[:, 2] = np.linspace(0, 0.02, frames)[:, None] * [1, 1, 0]
    return rotations, translations


def _stretch(character: Character, handles: Handles, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Sum of the squared changes of all edges' lengths over the extent, a frame each, through the reference
    skinning.
    """
    frames = len(rotations)
    motion = HandleMotion(translations, rotations, np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)), 20.0)
    posed = skin_reference(character.vertices, handles.weights, motion.transforms(handles.positions))
    edges = np.unique(np.sort(character.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)

    def lengths(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[..., edges[:, 0], :] - points[..., edges[:, 1], :], axis=-1)

    change = (lengths(posed.astype(float)) - lengths(character.vertices.astype(float))) / np.ptp(
        character.vertices, axis=0
    ).max()
    return np.square(change).sum(-1)


def test_the_mesh_is_stretched_less_and_the_root_stays() -> None:
    character, handles = _bar()
    rotations, translations = _pose()
    moved = Shape().moves(rotations, translations, character, handles, 1.0)
    before, after = (_stretch(character, handles, rotations, some) for some in (translations, translations + moved))
    assert (after[1:] < 0.8 * before[1:]).all()
    assert not moved[:, 0].any()
    assert np.linalg.norm(moved, axis=-1).max() <= Shape().longest * (1 + 1e-6)


def test_it_is_the_least_squares_solution() -> None:
    character, handles = _bar()
    rotations, translations = (values[3:4] for values in _pose())
    moved = Shape(steps=30, longest=1.0, stride=1).moves(rotations, translations, character, handles, 1.0)
    loss = float(_stretch(character, handles, rotations, translations)[0])
    weight = Shape().strength / (loss + Shape().calm)

    def objective(unknown: np.ndarray) -> float:
        delta = np.concatenate([np.zeros(3), unknown]).reshape(1, 3, 3)
        return float(unknown @ unknown + weight * _stretch(character, handles, rotations, translations + delta)[0])

    found = minimize(
        objective, np.zeros(6), method="Nelder-Mead", options={"maxfev": 20_000, "xatol": 1e-7, "fatol": 1e-13}
    ).x
    np.testing.assert_allclose(moved[0, 1:].ravel(), found, atol=2e-4)


def test_what_moves_as_one_is_left_alone() -> None:
    character, handles = _bar()
    turn = np.tile(matrix_from_axis_angle(np.array([0.3, 0.2, 0.9])), (4, 3, 1, 1))
    pivots = handles.positions - np.einsum("kij,kj->ki", turn[0], handles.positions)
    translations = np.tile(-pivots, (4, 1, 1))  # one rigid turn about the origin
    assert np.abs(Shape().moves(turn, translations, character, handles, 1.0)).max() < 1e-5


H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}


def snail():
    """A block whose lower half is shared between two legs, and whose sides are arms in nothing but name."""
    box = trimesh.creation.box((0.6, 0.5, 1.0)).subdivide().subdivide().subdivide()
    box.apply_translation((0, 0.25, 0))
    points = np.asarray(box.vertices, np.float32)
    weights = np.zeros((len(points), len(HANDLE_NAMES)), np.float32)
    low = np.clip(1 - points[:, 1] / 0.3, 0, 1)
    left = np.clip(0.5 + points[:, 0] / 0.6, 0, 1)
    weights[:, H["left_hip"]], weights[:, H["right_hip"]] = low * left, low * (1 - left)
    weights[:, H["spine2"]] = 0.5 * (1 - low)
    weights[:, H["head"]] = 0.5 * (1 - low)
    character = Character("snail", points, np.asarray(box.faces))
    mass = weights * character.areas[:, None]
    positions = mass.T @ points / np.maximum(mass.sum(axis=0), 1e-9)[:, None]
    return character, Handles(positions.astype(np.float32), weights)


def steps(frames=20):
    """Legs that swing against each other on the reference body."""
    count = len(HANDLE_NAMES)
    rotations = np.tile(np.eye(3), (frames, count, 1, 1))
    angles = 0.6 * np.sin(np.linspace(0, 2 * np.pi, frames))
    for side, sign in (("left", 1), ("right", -1)):
        turn = matrix_from_axis_angle(np.stack([sign * angles, 0 * angles, 0 * angles], axis=1))
        for part in ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist", "fingers"):
            rotations[:, H[f"{side}_{part}"]] = turn
    still = np.zeros((frames, count, 3)), np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1))
    return HandleMotion(still[0], rotations, still[1], still[2], 20.0)


def test_a_body_without_legs_is_not_torn_by_steps():
    character, handles = snail()
    anatomy = Anatomy.of(character, handles)
    assert anatomy.plan.kind == "no legs"
    held = fit_motion(steps(), anatomy).rotations
    legs = [H[f"{side}_hip"] for side in ("left", "right")]
    np.testing.assert_allclose(held[:, legs], np.broadcast_to(np.eye(3), held[:, legs].shape), atol=1e-5)
    free = fit_motion(steps(), anatomy, Stages(legless=False)).rotations
    assert np.abs(free[:, legs] - np.eye(3)).max() > 0.3


def test_a_body_without_legs_gets_ahead_in_hops():
    """Where it touches the ground it stands still."""
    anatomy = Anatomy.of(*snail())
    path = moved_so(steps(40), "step", slice(0, 40), anatomy).root_translation
    speed = np.diff(path[:, 2])
    on_ground = path[1:, 1] < 0.01 * path[:, 1].max()
    assert path[-1, 2] > 0.3 and np.ptp(path[:, 1]) > 0 and on_ground.any()
    assert np.abs(speed[on_ground & (path[:-1, 1] < 0.01 * path[:, 1].max())]).max() < 0.1 * speed.max()


def test_bones_that_a_rig_names_are_limbs():
    """A rig tells its joints, so what its bones are named moves, whatever the mesh looks like."""
    character, handles = snail()
    measured = Anatomy.of(character, handles)
    named = replace(Anatomy.of(character, handles, (measured.rotations, measured.joints)), named=True)
    assert named.plan.kind == "no legs"
    moved, other = fit_motion(steps(), named), fit_motion(steps(), named, Stages(legless=False))
    np.testing.assert_array_equal(moved.rotations, other.rotations)


def test_who_has_legs_steps():
    body = reference_body()
    anatomy = Anatomy.of(body.character(), body.handles)
    moved, other = fit_motion(steps(), anatomy), fit_motion(steps(), anatomy, Stages(legless=False))
    np.testing.assert_array_equal(moved.rotations, other.rotations)


FPS, FRAMES = 20.0, 80
CHEST, ARM, HAND = (HANDLE_NAMES.index(name) for name in ("spine3", "left_shoulder", "left_elbow"))


@pytest.fixture
def fish() -> tuple[Handles, Joints]:
    positions = np.zeros((30, 3))
    return Handles(positions, np.full((4, 30), 1 / 30)), Joints(positions, np.array(HANDLE_PARENTS), np.ones(30, bool))


def turned(arm: np.ndarray, trunk: float = 0.3) -> np.ndarray:
    """The whole body turned about +Y, and both parts of the left arm hanging by an angle each frame [rad]."""
    rotations = np.tile(matrix_from_axis_angle(np.array([0, trunk, 0])), (FRAMES, 30, 1, 1))
    hangs = matrix_from_axis_angle(-arm[:, None] * np.array([0, 0, 1.0]))
    for part in (ARM, HAND, *(HANDLE_NAMES.index(f"left_{name}") for name in ("wrist", "fingers"))):
        rotations[:, part] = rotations[:, part] @ hangs
    return rotations


def off_the_trunk(rotations: np.ndarray, part: int = ARM) -> np.ndarray:
    """How far a part is turned against the chest in each frame [rad]."""
    between = rotations[:, CHEST].transpose(0, 2, 1) @ rotations[:, part]
    return -np.asarray(axis_angle_from_matrix(between))[:, 2]


def test_fins_that_were_not_drawn_rest(fish):
    found = Fins().held(turned(np.full(FRAMES, 1.2)), *fish, False, FPS)
    np.testing.assert_allclose(off_the_trunk(found), 0, atol=1e-6)
    np.testing.assert_allclose(off_the_trunk(found, HAND), 0, atol=1e-6)


def test_fins_are_held_near_their_rest_and_beat(fish):
    beat = 0.3 * np.sin(2 * np.pi * 2 * np.arange(FRAMES) / FPS)
    found = off_the_trunk(Fins().held(turned(1.2 + beat), *fish, True, FPS))
    assert found[20:60].mean() == pytest.approx(Fins().aside, abs=0.03)
    assert np.ptp(found[20:60]) == pytest.approx(0.6, rel=0.1)


def clubbed():
    """The sample person with arms that reach far below its feet when they hang, and no hands."""
    person = make_sample("person", 0.5, rigged=True)
    weights = rig_handles(person).weights.copy()
    vertices = person.vertices.copy()
    for side in ("left", "right"):
        elbow, *hand = (HANDLE_NAMES.index(f"{side}_{part}") for part in ("elbow", "wrist", "fingers"))
        weights[:, elbow] += weights[:, hand].sum(axis=1)
        weights[:, hand] = 0
        wide = abs(float(vertices[weights[:, elbow] > 0.5, 0].mean()))
        far = np.abs(vertices[:, 0]) > wide
        vertices[far, 0] += 1.5 * (vertices[far, 0] - np.sign(vertices[far, 0]) * wide)
    character = replace(person, vertices=vertices, rig=None, source=None)
    return character, Handles(handle_positions(vertices, weights, character.areas), weights)


def test_an_arm_without_a_hand_does_not_sink():
    character, handles = clubbed()
    anatomy = Anatomy.of(character, handles)
    assert len(anatomy.stumps) == 2 and not anatomy.arms
    frames = 30
    rotations = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
    down = np.sin(np.linspace(0, np.pi, frames))
    for side, sign in (("left", -1), ("right", 1)):
        for part in ("shoulder", "elbow", "wrist", "fingers"):
            angle = sign * np.radians(85) * down[:, None] * [0, 0, 1.0]
            rotations[:, HANDLE_NAMES.index(f"{side}_{part}")] = matrix_from_axis_angle(angle)
    still = np.zeros((frames, 3))
    motion = HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), rotations, still, np.tile(np.eye(3), (frames, 1, 1)))

    def lowest(stages):
        fitted = fit_motion(motion, anatomy, stages)
        return float(skin(vertices, weights, fitted.transforms(handles.positions))[..., 1].min())

    seen = character.surface
    vertices, weights = character.vertices[seen], handles.weights[seen]
    assert lowest(Stages(floor=False)) < anatomy.floor - 0.1 * character.height
    assert lowest(Stages()) > anatomy.floor - 0.02 * character.height


FRONT_FRAMES = 41


@pytest.fixture(scope="module")
def dog():
    return RigParts.of(make_sample("dog", rigged=True))


def bowed(angle: float) -> HandleMotion:
    """The root tilts down by half of an angle and the trunk by the other half, most in the middle of the clip [rad]."""
    half = 0.5 * angle * np.sin(np.pi * np.arange(FRONT_FRAMES) / (FRONT_FRAMES - 1))
    turns = matrix_from_axis_angle(half[:, None] * np.array([1.0, 0, 0]))
    rotations = np.tile(np.eye(3), (FRONT_FRAMES, 30, 1, 1))
    for name in ("spine1", "spine2", "spine3", "neck", "head", "head_top", "face"):
        rotations[:, HANDLE_NAMES.index(name)] = turns
    return HandleMotion(
        np.zeros((FRONT_FRAMES, 30, 3)), rotations, np.zeros((FRONT_FRAMES, 3)), turns, 20.0
    ).of_own_body()


def head_heights(dog, motion: HandleMotion, rotations: np.ndarray) -> np.ndarray:
    """Of the lowest point of the head over the ground, over the height, shape (N,)."""
    turned, translations = attach_joints(rotations, dog.handles.positions, dog.joints)
    posed = HandleMotion(translations, turned, np.zeros((FRONT_FRAMES, 3)), motion.root_rotation, 20.0)
    held = dog.handles.weights[:, HANDLE_NAMES.index("head")] > 0.5
    character = dog.character
    heights = skin(character.vertices[held], dog.handles.weights[held], posed.transforms(dog.handles.positions))[..., 1]
    return (heights.min(axis=1) - character.vertices[:, 1].min()) / character.height


def test_a_head_that_would_sink_is_kept_above_the_ground(dog):
    motion = bowed(np.radians(150))
    before = head_heights(dog, motion, motion.rotations)
    moved, rotations = Front().raised(motion, motion.rotations, dog.anatomy)
    after = head_heights(dog, moved, rotations)
    assert before.min() < -0.1 and after.min() > -Front().sink - 0.01
    assert after.min() < 0.6 * after.max()  # it still bows
    np.testing.assert_allclose(rotations[[0, -1]], motion.rotations[[0, -1]], atol=1e-3)


def test_the_chest_does_not_come_down_to_the_ground(dog):
    """A crouch before a jump laid a bear and a sheep on their chests, with the rump up."""
    tilt = matrix_from_axis_angle(np.tile(np.radians([70.0, 0, 0]), (FRONT_FRAMES, 1)))
    still = np.zeros((FRONT_FRAMES, 3))
    level = np.tile(np.eye(3), (FRONT_FRAMES, 30, 1, 1))
    motion = HandleMotion(np.zeros((FRONT_FRAMES, 30, 3)), level, still, tilt, 20.0).of_own_body()
    leg = next(leg for leg in dog.anatomy.legs if HANDLE_NAMES[leg.upper].endswith("shoulder"))
    pelvis = dog.handles.positions[0]

    def drop(moved: HandleMotion) -> float:
        turned = moved.root_rotation[FRONT_FRAMES // 2] @ (leg.joints[0] - pelvis)
        return float(leg.joints[0][1] - pelvis[1] - turned[1]) / leg.length

    assert drop(motion) > 2 * Front().stoop
    assert drop(Front().raised(motion, motion.rotations, dog.anatomy)[0]) < Front().stoop + 0.02
