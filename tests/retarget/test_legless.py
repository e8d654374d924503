"""A body without legs or arms: what the predictor takes for limbs goes along with its trunk."""

import numpy as np
import trimesh

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.fit import Stages, fit_motion

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


def test_bones_that_a_rig_names_are_limbs():
    """A rig tells its joints, so what its bones are named moves, whatever the mesh looks like."""
    character, handles = snail()
    measured = Anatomy.of(character, handles)
    named = Anatomy.of(character, handles, (measured.rotations, measured.joints))
    assert named.plan.kind == "no legs"
    moved, other = fit_motion(steps(), named), fit_motion(steps(), named, Stages(legless=False))
    np.testing.assert_array_equal(moved.rotations, other.rotations)


def test_who_has_legs_steps():
    body = reference_body()
    anatomy = Anatomy.of(body.character(), body.handles)
    moved, other = fit_motion(steps(), anatomy), fit_motion(steps(), anatomy, Stages(legless=False))
    np.testing.assert_array_equal(moved.rotations, other.rotations)
