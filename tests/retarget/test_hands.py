"""Hands that touch the body stay near it, and hands that do not are left alone."""

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.geometry.surface import vertex_areas
from bunraku.retarget.body_motion import body_handle_motion
from bunraku.retarget.fit import Stages, fit_motion

PLAIN = Stages(ground=False, feet=False, smooth=False, floor=False)
HANDS = Stages(ground=False, feet=False, smooth=False, floor=False, hands=True)
_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}


def posed(shoulder, elbow, frames=20):
    """Both arms down by an angle and bent inwards by another [rad]."""
    turns = np.zeros((frames, 22, 3))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, _J[f"{side}_shoulder"], 2] = -sign * shoulder
        turns[:, _J[f"{side}_elbow"], 2] = -sign * elbow
    body = reference_body()
    return body_handle_motion(
        SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), 20.0)
    )


def wide(factor):
    """The reference body with broad hips and thighs between its usual shoulders and knees."""
    body = reference_body()
    vertices = body.vertices.copy()
    columns = [HANDLE_NAMES.index(name) for name in ("pelvis", "spine1", "left_hip", "right_hip")]
    share = body.handle_weights[:, columns].sum(axis=1)
    vertices[:, 0] *= 1 + (factor - 1) * share
    character = Character("wide", vertices, body.faces)
    return character, Handles(
        handle_positions(vertices, body.handle_weights, vertex_areas(vertices, body.faces)), body.handle_weights
    )


def palm(motion, character, handles, side="left"):
    wrist = HANDLE_NAMES.index(f"{side}_wrist")
    own = handles.weights[:, [wrist, wrist + 2]].sum(axis=1) > 0.5
    transforms = motion.transforms(handles.positions)[:, wrist]
    middle = character.vertices[own].mean(axis=0)
    return transforms[..., :3] @ middle + transforms[..., 3]


def test_the_reference_body_keeps_its_arms():
    motion = posed(1.45, 0.0)
    character, handles = wide(1.0)
    plain, kept = (
        fit_motion(motion, Anatomy.of(character, handles), PLAIN),
        fit_motion(motion, Anatomy.of(character, handles), HANDS),
    )
    assert np.abs(palm(plain, character, handles) - palm(kept, character, handles)).max() < 0.02


def test_hands_at_the_thighs_give_way_to_wide_hips():
    motion = posed(1.5, 0.0)
    character, handles = wide(1.8)
    plain, kept = (
        fit_motion(motion, Anatomy.of(character, handles), PLAIN),
        fit_motion(motion, Anatomy.of(character, handles), HANDS),
    )
    outwards = palm(kept, character, handles)[:, 0] - palm(plain, character, handles)[:, 0]
    assert outwards.min() > 0.03


@pytest.mark.parametrize("factor", [1.0, 1.8])
def test_hands_away_from_the_body_are_left_alone(factor):
    motion = posed(0.0, 0.0)
    character, handles = wide(factor)
    plain, kept = (
        fit_motion(motion, Anatomy.of(character, handles), PLAIN),
        fit_motion(motion, Anatomy.of(character, handles), HANDS),
    )
    assert np.abs(plain.rotations - kept.rotations).max() < 1e-5
