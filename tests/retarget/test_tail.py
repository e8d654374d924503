"""Tails that are held up: checked by where the tail of the sample dog points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bunraku.anatomy.joints import Joints, attach_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.trailing.tail import Tail, TailClear
from bunraku_lab.synthetic.samples import make_sample

FPS, FRAMES = 20.0, 60
TAIL, TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")


def body(rest: float) -> tuple[Handles, Joints]:
    """A tail of two parts that rests so far above the level behind the body [rad]."""
    positions = np.zeros((30, 3))
    back = np.array([0, np.sin(rest), -np.cos(rest)])
    joints = Joints(positions.copy(), np.zeros(30, int), np.ones(30, bool))
    joints.positions[TIP], positions[TAIL], positions[TIP] = back, 0.5 * back, 1.5 * back
    return Handles(positions, np.full((4, 30), 1 / 30)), joints


def pitch(rotations: np.ndarray, rest: float) -> np.ndarray:
    """How far the tip points up in each frame [rad]."""
    points = rotations[:, TIP] @ np.array([0, np.sin(rest), -np.cos(rest)])
    return np.arctan2(points[:, 1], -points[:, 2])


def lifted(angles: np.ndarray) -> np.ndarray:
    rotations = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    turns = matrix_from_axis_angle(angles[:, None] * np.array([1.0, 0, 0]))
    rotations[:, TAIL], rotations[:, TIP] = turns, turns
    return rotations


@pytest.mark.parametrize(
    ("rest", "raised", "expected"),
    [
        (0.0, 80, np.degrees(Tail().highest)),  # a rat's, as a horse's is raised in a gallop
        (-np.radians(70), 80, 10),  # the horse's own
        (np.radians(60), 80, 60),  # curled up at rest
        (0.0, 15, 15),
        (0.0, -40, -40),
    ],
)
def test_a_tail_is_held_no_higher_than_it_rests_or_streams(rest, raised, expected):
    handles, joints = body(rest)
    found = Tail().lowered(lifted(np.full(FRAMES, np.radians(raised))), handles, joints, FPS)
    np.testing.assert_allclose(np.degrees(pitch(found, rest)), expected, atol=1e-6)


def test_a_tail_still_wags():
    handles, joints = body(0.0)
    swing = 0.3 * np.sin(2 * np.pi * 2 * np.arange(FRAMES) / FPS)
    found = pitch(Tail().lowered(lifted(np.radians(80) + swing), handles, joints, FPS), 0.0)
    assert found[10:50].mean() == pytest.approx(Tail().highest, abs=0.03)
    assert np.ptp(found[10:50]) == pytest.approx(np.ptp(swing), rel=0.05)


def test_what_is_not_held_up_stays_bit_for_bit():
    handles, joints = body(0.0)
    rotations = lifted(np.zeros(FRAMES))
    assert Tail().lowered(rotations, handles, joints, FPS) is rotations


def test_a_tail_is_turned_up_where_it_would_sink():
    dog = RigParts.of(make_sample("dog", rigged=True))
    motion = HandleMotion(
        np.zeros((FRAMES, 30, 3)), np.tile(np.eye(3), (FRAMES, 30, 1, 1)), np.zeros((FRAMES, 3)),
        np.tile(np.eye(3), (FRAMES, 1, 1)), FPS,
    )  # fmt: skip
    floor = float(dog.character.vertices[:, 1].min())
    assert TailClear().raised(motion, dog.anatomy) is motion
    hangs = matrix_from_axis_angle(-1.4 * np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * np.array([1.0, 0, 0]))
    path, rotations = np.zeros((FRAMES, 3)), motion.rotations.copy()
    path[:, 1], rotations[:, [TAIL, TIP]] = -0.55 * dog.character.height, hangs[:, None]
    motion = replace(motion, rotations=rotations, root_translation=path)
    motion = attached(motion, dog)
    raised = TailClear().raised(motion, dog.anatomy)
    held = dog.handles.weights[:, [TAIL, TIP]].sum(axis=1) > 0.9
    low = [
        Animation(dog.character, dog.handles, one).vertices()[:, held, 1].min(axis=1) - floor
        for one in (motion, raised)
    ]
    assert low[0].min() < -0.03 * dog.character.height
    assert low[1].min() > -0.006 * dog.character.height
    np.testing.assert_allclose(raised.rotations[:, :20], motion.rotations[:, :20], atol=1e-6)


def attached(motion: HandleMotion, parts: RigParts) -> HandleMotion:
    rotations, translations = attach_joints(motion.rotations.astype(float), parts.handles, parts.joints)
    return replace(motion, rotations=rotations, translations=translations)
