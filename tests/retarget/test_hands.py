"""Hands: where they reach, clear of the body, and pinned."""

from dataclasses import replace

import numpy as np
import pytest
from look import hands_in_body

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import OptionError
from bunraku.files.samples import sample_character
from bunraku.generation.features import body_handle_motion
from bunraku.pipelines.animate import rig
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.pins import PINNED, Pin, end_positions, limb_ends, meet_pins
from bunraku.retarget.stages.hands import BodySurface, HandsClear
from bunraku_lab.synthetic.samples import make_sample

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


def moved_by(motion, factor):
    """How far the stages of hands move the left palm of a body that is so wide."""
    body = wide(factor)
    plain, kept = (palm(fit_motion(motion, Anatomy.of(*body), stages), *body) for stages in (PLAIN, HANDS))
    return kept - plain


def test_the_reference_body_keeps_its_arms():
    assert np.abs(moved_by(posed(1.45, 0.0), 1.0)).max() < 0.02


def test_hands_at_the_thighs_give_way_to_wide_hips():
    assert moved_by(posed(1.5, 0.0), 1.8)[:, 0].min() > 0.03


@pytest.mark.parametrize("factor", [1.0, 1.8])
def test_hands_away_from_the_body_are_left_alone(factor):
    motion = posed(0.0, 0.0)
    character, handles = wide(factor)
    plain, kept = (fit_motion(motion, Anatomy.of(character, handles), stages) for stages in (PLAIN, HANDS))
    assert np.abs(plain.rotations - kept.rotations).max() < 1e-5


WITHOUT = Stages(ground=False, feet=False, smooth=False, floor=False, hands_clear=False)
WITH = Stages(ground=False, feet=False, smooth=False, floor=False)


@pytest.fixture(scope="module")
def anatomy():
    body = reference_body()
    return Anatomy.of(body.character(), body.handles)


def bent(elbow, frames=48):
    """Arms down, forearms bent inwards [rad] from one end of the clip to the other and back."""
    turns = np.zeros((frames, 22, 3))
    share = np.sin(np.linspace(0, np.pi, frames))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, JOINT_NAMES.index(f"{side}_shoulder"), 2] = -sign * 1.2
        turns[:, JOINT_NAMES.index(f"{side}_elbow"), 2] = -sign * elbow * share
    body = reference_body()
    return body_handle_motion(
        SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), 20.0)
    )


def test_hands_in_the_hips_come_out_of_them(anatomy):
    motion = bent(0.65).of_own_body()
    before, after = (fit_motion(motion, anatomy, stages) for stages in (WITHOUT, WITH))
    assert hands_in_body(before, 1).mean() > 0.2
    assert not hands_in_body(after, 1).any()
    step = np.linalg.norm(np.diff(after.transforms(anatomy.handles.positions)[:, 20, :, 3], axis=0), axis=1)
    usual = np.linalg.norm(np.diff(before.transforms(anatomy.handles.positions)[:, 20, :, 3], axis=0), axis=1)
    assert step.max() < 2 * usual.max()  # without a jump


def test_depths_are_those_of_looking_at_every_part(anatomy):
    motion = bent(1.2).of_own_body()
    stage, surface = HandsClear(), BodySurface(anatomy)
    hands = stage.hand(motion, anatomy.arms[0], anatomy)
    found, out = surface.depths(motion, hands, 0.15)
    world = motion.transforms(anatomy.handles.positions).astype(float)
    for frame in range(0, len(motion), 7):
        for point in range(0, hands.shape[1], 11):
            best, depth = 0.15, -np.inf
            for part in surface._parts:
                local = world[frame, part.handle, :, :3].T @ (hands[frame, point] - world[frame, part.handle, :, 3])
                away = np.linalg.norm(part.points - local, axis=1)
                if away.min() < best:
                    nearest = int(away.argmin())
                    best, depth = away[nearest], (part.points[nearest] - local) @ part.normals[nearest]
            outside = np.isinf(found[frame, point]) and depth <= 0  # far out, so that nothing looks at it
            assert outside or found[frame, point] == pytest.approx(depth, abs=1e-9)
            assert np.isinf(found[frame, point]) or np.linalg.norm(out[frame, point]) == pytest.approx(1, abs=1e-5)


HUMAN = 1.7


@pytest.fixture(scope="module", params=["person", "dragon"])
def moving(request, swing):
    character = sample_character(request.param)
    handles = rig(character)
    return character, handles, fit_motion(swing("spine2", frames=80), Anatomy.of(character, handles))


@pytest.fixture(scope="module")
def swing():
    from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES

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
