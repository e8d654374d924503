"""Pins: met within a centimetre and two degrees, and nothing changed out of their reach."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.handles.from_rig import rig_handles
from bunraku.pipelines.animate import rig
from bunraku.retarget.fit import fit_motion
from bunraku.retarget.stages.pins import PINNED, Pin, end_positions, limb_ends, meet_pins, spread
from bunraku.samples import sample_character
from bunraku_lab.synthetic.samples import make_sample

HUMAN = 1.7


@pytest.fixture(scope="module", params=["person", "dragon"])
def moving(request, swing):
    character = sample_character(request.param)
    handles = rig(character)
    return character, handles, fit_motion(swing("spine2", frames=80), Anatomy.of(character, handles))


@pytest.fixture(scope="module")
def swing():
    from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES

    def make(handle, frames=60):
        vectors = np.zeros((frames, HANDLE_COUNT, 3))
        vectors[:, HANDLE_NAMES.index(handle), 2] = 0.2 * np.sin(np.arange(frames) * 0.3)
        zero = np.zeros((frames, 3))
        return HandleMotion(
            np.zeros((frames, HANDLE_COUNT, 3)), matrix_from_axis_angle(vectors), zero,
            np.broadcast_to(np.eye(3), (frames, 3, 3)),
        )  # fmt: skip

    return make


def positions(moving, motion):
    character, handles, _ = moving
    ends = limb_ends(Anatomy.of(character, handles))
    return {
        end.part: position
        for end, position in zip(ends, end_positions(motion, handles, ends).swapaxes(0, 1), strict=True)
    }


def test_people_and_beasts_have_four_ends(moving):
    assert [end.part for end in limb_ends(Anatomy.of(*moving[:2]))] == list(PINNED)


@pytest.mark.parametrize("part", PINNED)
@pytest.mark.parametrize("off", [(0.05, 0.1, 0.1), (0.0, 0.6, 1.2)])
def test_a_pin_is_met_while_it_holds(moving, part, off):
    character, handles, motion = moving
    size = character.height / HUMAN
    goal = positions(moving, motion)[part][40] + np.array(off) * size
    met = meet_pins(motion, Anatomy.of(character, handles), [Pin(part, 2.0, tuple(goal), hold=0.25)])
    away = np.linalg.norm(positions(moving, met)[part][40:46] - goal, axis=1)
    assert away.max() / size < 0.01
    for name in HandleMotion.arrays:
        np.testing.assert_array_equal(getattr(met, name)[:20], getattr(motion, name)[:20])
        np.testing.assert_array_equal(getattr(met, name)[66:], getattr(motion, name)[66:])


def test_a_turn_is_met(moving):
    character, handles, motion = moving
    ends = {end.part: end for end in limb_ends(Anatomy.of(character, handles))}
    goal = positions(moving, motion)["right_hand"][40]
    turn = matrix_from_axis_angle(np.array([[0.3, -0.8, 0.2]]))[0]
    met = meet_pins(motion, Anatomy.of(character, handles), [Pin("right_hand", 2.0, tuple(goal), turn)])
    now = met.transforms(handles.positions)[40, ends["right_hand"].handle, :, :3].astype(float)
    angle = np.rad2deg(np.arccos(np.clip((np.trace(now @ turn.T) - 1) / 2, -1, 1)))
    assert angle < 2
    assert np.linalg.norm(positions(moving, met)["right_hand"][40] - goal) < 0.01


def test_several_pins_at_one_time_and_after_another(moving):
    character, handles, motion = moving
    size, here = character.height / HUMAN, positions(moving, motion)
    pins = [
        Pin("left_hand", 1.0, tuple(here["left_hand"][20] + np.array([0, 0.1, 0.1]) * size)),
        Pin("right_foot", 1.0, tuple(here["right_foot"][20] + np.array([0, 0.1, 0.0]) * size)),
        Pin("left_hand", 1.3, tuple(here["left_hand"][26] + np.array([0, 0.0, 0.2]) * size)),
    ]
    found = positions(moving, meet_pins(motion, Anatomy.of(character, handles), pins))
    for pin in pins:
        assert np.linalg.norm(found[pin.part][round(pin.time * 20)] - pin.position) / size < 0.01


def test_standing_feet_stay_where_the_root_goes_to_reach(moving):
    character, handles, motion = moving
    size, here = character.height / HUMAN, positions(moving, motion)
    goal = here["left_hand"][40] + np.array([0, 0, 0.1]) * size
    found = positions(moving, meet_pins(motion, Anatomy.of(character, handles), [Pin("left_hand", 2.0, tuple(goal))]))
    for foot in ("left_foot", "right_foot"):
        assert np.linalg.norm(found[foot] - here[foot], axis=1).max() / size < 0.02


@pytest.mark.parametrize(
    ("pins", "part"),
    [
        ([("left_hand", 9.0, (0, 1, 0))], "after the end"),
        ([("left_hand", 1.0, (5, 1, 0)), ("right_hand", 1.0, (-5, 1, 0))], "too far apart"),
    ],
)
def test_what_cannot_be_met_is_said(moving, pins, part):
    character, handles, motion = moving
    with pytest.raises(OptionError, match=part):
        meet_pins(motion, Anatomy.of(character, handles), [Pin(*pin) for pin in pins])


@pytest.mark.parametrize(
    "values",
    [("nose", 1, (0, 1, 0)), ("left_hand", -1, (0, 1, 0)), ("left_hand", 1, (0, float("nan"), 0)),
     ("left_hand", 1, (0, 1)), ("left_hand", 1, (0, 1, 0), np.diag([1, 1, -1])), ("left_hand", 1, (0, 1, 0), None, -1)],
)  # fmt: skip
def test_pins_that_are_none(values):
    with pytest.raises(OptionError):
        Pin(*values)


def test_who_has_no_hands_cannot_pin_one():
    character = make_sample("person", 0.5, rigged=True)
    whole = rig_handles(character)
    arm = [HANDLE_NAMES.index(f"left_{part}") for part in ("shoulder", "elbow", "wrist")]
    weights = whole.weights.copy()
    weights[:, HANDLE_NAMES.index("spine3")] += weights[:, arm].sum(axis=1)
    weights[:, arm] = 0
    handles = replace(whole, weights=weights)
    motion = HandleMotion(
        np.zeros((40, 30, 3)), np.broadcast_to(np.eye(3), (40, 30, 3, 3)), np.zeros((40, 3)),
        np.broadcast_to(np.eye(3), (40, 3, 3)),
    )  # fmt: skip
    assert [end.part for end in limb_ends(Anatomy.of(character, handles))] == [
        part for part in PINNED if part != "left_hand"
    ]
    with pytest.raises(OptionError, match="has no"):
        meet_pins(motion, Anatomy.of(character, handles), [Pin("left_hand", 1.0, (0, 0, 0))])


def test_a_spread_goes_through_its_values_and_back_to_nothing():
    asked, values = np.zeros(60, bool), np.zeros((60, 1))
    asked[[20, 25, 50]], values[[20, 25, 50], 0] = True, [1, 3, -2]
    found = spread(asked, values, 8)[:, 0]
    assert found[[20, 25, 50]].tolist() == [1, 3, -2]
    assert (found[:13] == 0).all() and (found[33:42] == 0).all() and (found[58:] == 0).all()
    assert (np.diff(found[20:26]) >= 0).all() and np.abs(np.diff(found, 2)).max() < 1.2
