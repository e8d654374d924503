"""An anatomy works out each thing once, and keeps it for the very object alone."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.plan import BodyPlan
from bunraku.body.layout import HANDLE_COUNT
from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import CharacterError
from bunraku.handles.from_rig import rig_handles
from bunraku_lab.synthetic.samples import make_sample


def body(width: float = 1.0) -> Anatomy:
    found = reference_body()
    size = np.array([width, 1, 1], np.float32)
    return Anatomy.of(Character("wide", found.vertices * size, found.faces), found.handles)


def calls(work, *names):
    """How often functions of these names are called by some work."""
    seen = dict.fromkeys(names, 0)

    def profile(frame, event, _):
        if event == "call" and frame.f_code.co_name in seen:
            seen[frame.f_code.co_name] += 1

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(before)
    return seen


def test_each_thing_is_worked_out_once():
    reference_anatomy()

    def work():
        found = body()
        for _ in range(3):
            assert found.plan.kind == "person" and len(found.legs) == 2 and len(found.arms) == 2
            assert found.scale == pytest.approx(1, abs=0.02) and abs(found.floor) < 0.01
            assert found.unturned.legs and found.unturned.joints.present.any()

    assert calls(work, "find_joints", "plan_of", "decimated") == {"find_joints": 1, "plan_of": 1, "decimated": 1}


def test_what_is_worked_out_is_the_objects_own_and_cannot_be_written_to():
    one, other, wider = body(), body(), body(1.2)
    assert one.joints is one.joints and one.joints is not other.joints
    np.testing.assert_array_equal(one.joints.positions, other.joints.positions)
    assert not np.array_equal(one.joints.positions, wider.joints.positions)
    with pytest.raises(ValueError, match="read-only"):
        one.joints.positions[0] = 1


def test_nothing_is_turned_in_a_body_that_is_taken_as_it_rests():
    dog = make_sample("dog", 0.3, rigged=True)
    found = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    assert found.plan == replace(found.plan, hind=2, front=2, upright=False) and isinstance(found.plan, BodyPlan)
    np.testing.assert_array_equal(found.unturned.rotations, np.tile(np.eye(3), (30, 1, 1)))
    np.testing.assert_allclose(found.unturned.stance[0].vertices, found.mesh.vertices, atol=1e-5)
    assert np.abs(found.rotations - np.eye(3)).max() > 0.1  # forelegs are arms that hang down


def test_a_rig_says_how_the_body_rests():
    found = body()
    known = Anatomy.of(found.character, found.handles, (found.rotations, found.joints))
    assert known.joints is found.joints and known.unturned.joints is found.joints
    assert known.scale == found.scale


def test_other_handles_than_those_of_a_body_are_refused():
    found = body().character
    with pytest.raises(CharacterError, match="30 handles, not 5"):
        Anatomy.of(found, Handles(np.zeros((5, 3)), np.eye(5)[np.zeros(len(found.vertices), int)]))


def test_what_reaches_the_ground_is_the_lowest_of_all_that_may_stand():
    found = body()
    angles = np.radians([0, 20, 50, 80])
    turns = np.tile(np.eye(3), (4, 1, 1))
    turns[:, 1:, 1:] = [[[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]] for a in angles]  # falls on its face
    still = np.tile(np.eye(3), (4, HANDLE_COUNT, 1, 1))
    motion = HandleMotion(np.zeros((4, HANDLE_COUNT, 3)), still, np.zeros((4, 3)), turns, 20.0)
    seen = found.reach.lowest(motion, found.handles.positions)
    points, root = found.mesh.vertices[found.stands], found.handles.positions[0]
    true = ((points - root) @ turns.swapaxes(1, 2))[..., 1].min(axis=1) + root[1]
    assert (seen >= true - 1e-5).all() and (seen <= true + 0.01).all()
