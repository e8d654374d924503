"""Performing gestures: blended into a motion, accompanied by the trunk, and posed limb by limb."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.core.body.layout import JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion
from bunraku.generation.pack import load_examples
from bunraku.gestures.catalogue import gestures
from bunraku.gestures.limb_gesture import in_stance, limb_gesture
from bunraku.gestures.perform import accompanied, performed
from bunraku.gestures.play import AT, Tracks, captured, gesture_motion, posed, stands_well, swaying
from bunraku.gestures.pose import Pose
from bunraku.language.posing import Manner, Stance, posing_of


def gesture(name):
    return next(one for one in gestures() if one.name == name)


def idle(seed=0, frames=80):
    """Somebody made by code who stands turned away and shifts the weight."""
    random = np.random.default_rng(seed)
    moments = np.arange(frames) / 20
    motion = posed(Tracks.of([(0.0, Pose()), (4.0, Pose())]), np.array([0.0, 4.0]), moments, swaying(seed, moments), 20)
    turn = matrix_from_axis_angle(np.array([0, random.uniform(-3, 3), 0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = turn @ rotations[:, 0]
    root = motion.root_translation @ turn.T + [2.0, 0, 1.0]
    return SkeletalMotion(motion.skeleton, rotations, root.astype(np.float32))


IDLES = [idle(seed) for seed in range(3)]


def world(name, seed, frames=120, **manner):
    return performed(gesture(name), frames, IDLES, np.random.default_rng(seed), Manner(**manner)).world()[1]


def test_who_only_stands_is_the_captured_one():
    one = idle(4)
    still = Tracks.of([(0.0, Pose()), (4.0, Pose())])
    moments = np.arange(80) / 20
    found = posed(still, np.array([0.0, 4.0]), moments, captured(one, np.arange(80.0)), 20).world()[1]
    _, wanted = one.world()
    between = lambda values: np.linalg.norm(values[:, 1:] - values[:, JOINT_PARENTS[1:]], axis=-1)  # noqa: E731
    np.testing.assert_allclose(between(found), between(wanted), atol=1e-4)
    facing = found[0, 1] - found[0, 2]
    assert facing[0] > 0.1 and abs(facing[2]) < 0.02  # it faces +z, over the origin
    assert np.abs(found[:, 0, [0, 2]]).max() < 0.05
    away = lambda values: np.linalg.norm(values[:, :, None] - values[:, None], axis=-1)  # noqa: E731
    np.testing.assert_allclose(away(found), away(wanted), atol=0.012)  # where a straight limb is bent to


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_claps_are_counted(count):
    there = world("clap", count, count=count)
    away = np.linalg.norm(there[:, AT["left_wrist"]] - there[:, AT["right_wrist"]], axis=1)
    near = (away[1:-1] < away[:-2]) & (away[1:-1] <= away[2:]) & (away[1:-1] < 0.2)
    assert near.sum() == count
    assert min(away[0], away[-1]) > 0.35  # arms hang before and after


def test_what_is_done_once_is_done_again_where_a_number_is_said():
    up = world("salute", 3, frames=160, count=2)[:, AT["right_wrist"], 1] > 1.5
    assert (np.diff(up.astype(int)) == 1).sum() == 2


def test_a_throw_is_made_again_from_where_it_ended_where_a_body_would_stand_idle():
    once, filled, landing = (world(*how) for how in (("pitch", 3, 80), ("pitch", 3, 140), ("land from a fall", 3, 140)))
    assert once[-1, 0, 2] - once[0, 0, 2] < 0.8 and filled[-1, 0, 2] - filled[0, 0, 2] > 1
    assert np.abs(np.diff(filled[:, 0, 2])).max() < 0.2
    assert (landing[:, 0, 1] < 0.75).mean() > 0.4  # a crouch is held in its place


@pytest.mark.parametrize("name", ["clap", "wave", "sit", "salute", "knock", "nod"])
def test_no_two_are_alike_and_the_same_seed_gives_the_same(name):
    first, again, other = (world(name, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.linalg.norm(first - other, axis=-1).max() > 0.03
    speed = np.linalg.norm(np.diff(first[:, 0], axis=0), axis=-1)
    assert speed.max() > 1e-4  # the pelvis is never frozen


def test_hands_that_touch_still_touch_whatever_the_size():
    for seed in range(4):
        there = world("clap", seed)
        nearest = np.linalg.norm(there[:, AT["left_wrist"]] - there[:, AT["right_wrist"]], axis=1).min()
        assert 0.04 < nearest < 0.2
        face = world("facepalm", seed)
        away = np.linalg.norm(face[:, AT["right_wrist"]] - face[:, AT["head"]], axis=1).min()
        assert 0.05 < away < 0.3


@pytest.mark.parametrize("name", ["clap", "sit", "point"])
def test_feet_stay_where_the_captured_ones_are(name):
    for seed in range(4):
        there = world(name, seed)
        for side in ("left", "right"):
            assert np.ptp(there[:, AT[f"{side}_ankle"]], axis=0).max() < 0.03


@pytest.mark.parametrize("number", range(len(gestures())), ids=lambda number: f"{gestures()[number].name}-{number}")
def test_every_gesture_is_performed_whole_in_any_time(number):
    one = gestures()[number]
    for frames in (20, 120):
        motion = performed(one, frames, IDLES, np.random.default_rng(number))
        assert len(motion) == frames
        rotations, positions = motion.world()
        assert np.isfinite(rotations).all()
        if frames > 60:  # who has a second hurries
            assert np.linalg.norm(np.diff(positions, axis=0), axis=-1).max() < 0.75
        assert positions[:, [AT["left_ankle"], AT["right_ankle"]], 1].min() > 0.04


@pytest.mark.parametrize("name", ["crawl", "march in place", "swim"])
def test_who_is_in_the_midst_of_it_does_not_stop_there(name):
    for seed in range(4):
        speed = np.linalg.norm(np.diff(world(name, seed), axis=0), axis=-1).max(axis=1)
        assert speed.reshape(-1, 7).max(axis=1).min() > 0.01


def test_a_loop_ends_as_it_begins():
    for name in ("clap", "wave", "march in place"):
        there = world(name, 2, closed=True)
        step = np.linalg.norm(np.diff(there - there[:, :1] * [1, 0, 1], axis=0), axis=-1).max()
        round_ = there - there[:, :1] * [1, 0, 1]
        assert np.linalg.norm(round_[0] - round_[-1], axis=-1).max() < 1.5 * step


def test_the_shipped_idles_stand_on_both_feet():
    pack = load_examples()
    assert pack is not None and len(pack.idles) >= 8
    assert all(map(stands_well, pack.idles))
    rest = reference_body().joints
    for one in pack.idles:
        assert abs(np.median(one.root_translation[:, 1]) - rest[0, 1]) < 0.08


def test_who_makes_a_gesture_shifts_as_far_as_captured_people_do():
    """Calm people are drawn less often, and their shifts are made larger, with their feet where they are."""
    ranges, feet = [], []
    for seed in range(12):
        one = performed(gesture("wave"), 120, load_examples().idles, np.random.default_rng(seed))
        positions = one.world()[1]
        ranges.append(np.linalg.norm(np.ptp(positions[:, 0][:, [0, 2]], axis=0)))
        feet.append(np.ptp(positions[:, AT["left_ankle"]], axis=0).max())
    assert np.median(ranges) > 0.1 and max(ranges) < 0.3 and max(feet) < 0.06


def test_legs_and_trunk_are_those_of_a_busy_person_and_idle_hands_those_of_an_idle_one():
    busy = [idle(seed + 9) for seed in range(2)]
    busy = [SkeletalMotion(one.skeleton, one.rotations, one.root_translation * [3, 1, 3]) for one in busy]
    ways, hands = [], []
    for seed in range(24):
        random = lambda: np.random.default_rng(seed)  # noqa: B023, E731
        calm, lively = (performed(gesture("salute"), 120, IDLES, random(), busy=some) for some in ((), busy))
        ways.append([np.ptp(one.root_translation[:, [0, 2]], axis=0).max() for one in (calm, lively)])
        _, there = lively.world()
        hands.append(there[:, AT["left_shoulder"], 1] - there[:, AT["left_wrist"], 1])
    assert len({tuple(np.round(way, 4)) for way in ways if way[0] != way[1]}) > 12  # most of them
    assert np.min(hands) > 0.35  # arms hang


def test_who_makes_a_gesture_does_not_stoop_as_people_do_who_talk():
    def bent(positions):  # degrees by which both knees and the trunk are
        hip, knee, ankle, pelvis, neck = (
            np.stack([positions[:, AT[name]] for name in names])
            for names in (("left_hip", "right_hip"), ("left_knee", "right_knee"), ("left_ankle", "right_ankle"),
                          ("pelvis",), ("neck",))
        )  # fmt: skip
        thigh, shin, trunk = knee - hip, ankle - knee, (neck - pelvis)[0]
        cosine = (thigh * shin).sum(-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shin, axis=-1)
        return np.degrees(np.arccos(cosine)).mean(), np.degrees(np.arctan2(trunk[:, 2], trunk[:, 1])).mean()

    pack = load_examples()
    knees, leans = np.transpose([
        bent(performed(gesture("wave"), 60, pack.idles, np.random.default_rng(seed), busy=pack.busy).world()[1])
        for seed in range(16)
    ])  # fmt: skip
    assert np.median(knees) < 30, knees.round()
    assert leans.max() < 12, leans.round()


def tracks(name):
    return Tracks.of(next(one for one in gestures() if one.name == name).keys)


def free(count, value=True):
    return {side: np.full(count, value) for side in ("left", "right")}


def test_a_hand_that_goes_ahead_takes_its_shoulder_along_and_the_head_looks_on():
    before = tracks("shake hands")
    count = len(before.turn)
    after = accompanied(before, np.ones(count), free(count))
    there = ~before.hands["right"].rests
    assert (after.turn - before.turn)[there].max() > 5  # to the left: the right shoulder is ahead
    assert (after.lean - before.lean)[there, 1].max() > 5
    assert (after.head - before.head)[there, 1].min() < -5
    assert np.abs((after.turn - before.turn)[~there]).max() == 0


def test_a_free_hand_stays_where_it_is_in_the_world():
    before = tracks("shake hands")
    count = len(before.turn)
    after = accompanied(before, np.ones(count), free(count))
    turned = np.radians((after.turn - before.turn) + (after.lean - before.lean)[:, 1])
    x, z = after.hands["right"].palm[:, 0] * -1, after.hands["right"].palm[:, 2]
    world = np.stack([x * np.cos(turned) + z * np.sin(turned), z * np.cos(turned) - x * np.sin(turned)], axis=1)
    np.testing.assert_allclose(world[:, 0], before.hands["right"].palm[:, 0] * -1, atol=1e-6)
    np.testing.assert_allclose(world[:, 1], before.hands["right"].palm[:, 2], atol=1e-6)


def test_hands_that_touch_go_with_the_body_and_both_alike_turn_nothing():
    claps = tracks("clap")
    count = len(claps.turn)
    after = accompanied(claps, np.ones(count), free(count, False))
    np.testing.assert_allclose(after.turn, claps.turn, atol=1e-9)
    np.testing.assert_array_equal(after.hands["right"].palm, claps.hands["right"].palm)


def joints(predicate):
    """Positions (N, 22, 3) and world rotations (N, 22, 3, 3) through the gesture of a sentence."""
    rotations, positions = gesture_motion(limb_gesture(posing_of(predicate))).world()
    return positions, rotations


def at(positions, name):
    return positions[:, AT[name]]


def test_an_arm_to_the_side_at_the_height_of_the_shoulder():
    positions, _ = joints("raises the left arm to the side to shoulder height and holds it")
    wrist, shoulder = at(positions, "left_wrist")[-1], at(positions, "left_shoulder")[-1]
    assert abs(wrist[1] - shoulder[1]) < 0.1 and wrist[0] - shoulder[0] > 0.45
    assert at(positions, "left_wrist")[0, 1] < shoulder[1] - 0.4  # it hung before
    assert (at(positions, "right_wrist")[:, 1] < 1.1).all()


def test_more_and_less():
    def rise(word):
        positions, _ = joints(f"raises the right arm {word} forward and holds it")
        return at(positions, "right_wrist")[-1, 1]

    assert rise("slightly") < rise("straight") - 0.2


def test_a_leg_goes_back_and_forth_on_one_side():
    positions, _ = joints("swings the left leg back and forth")
    left, right = (at(positions, f"{side}_ankle") for side in ("left", "right"))
    assert left[:, 2].max() > 0.35 and left[:, 2].min() < -0.3
    assert np.ptp(right, axis=0).max() < 0.05
    crossings = np.diff(np.sign(left[:, 2])) != 0
    assert crossings.sum() >= 5


def test_who_stands_with_crossed_legs_stands():
    positions, _ = joints("stands with legs crossed")
    left, right = (at(positions, f"{side}_ankle") for side in ("left", "right"))
    assert (left[:, 0] < right[:, 0]).all() and at(positions, "pelvis")[:, 1].min() > 0.9


@pytest.mark.parametrize(
    ("stance", "least", "most"),
    [("stands", 0.9, 1.1), ("sits on a chair", 0.45, 0.65), ("kneels", 0.4, 0.6), ("squats", 0.5, 0.7),
     ("sits on the floor", 0.05, 0.2), ("lies on the back", 0.05, 0.2), ("lies on the belly", 0.05, 0.2)],
)  # fmt: skip
def test_both_arms_go_to_the_sides_in_any_stance(stance, least, most):
    positions, rotations = joints(f"{stance} with the arms stretched out to the sides")
    assert least < at(positions, "pelvis")[:, 1].min() and at(positions, "pelvis")[:, 1].max() < most
    for side, sign in (("left", 1), ("right", -1)):
        out = at(positions, f"{side}_wrist") - at(positions, f"{side}_shoulder")
        across = sign * rotations[:, AT["spine3"], :, 0]
        assert ((out * across).sum(axis=1) > 0.4).all()
    assert positions[..., 1].min() > -0.05


@pytest.mark.parametrize(
    "sentence", ["bends forward with the hands on the knees", "sits on a chair with the hands on the knees"]
)
def test_hands_are_on_the_knees(sentence):
    positions, _ = joints(sentence)
    away = [
        np.linalg.norm(at(positions, f"{side}_wrist") - at(positions, f"{side}_knee"), axis=1)
        for side in ("left", "right")
    ]
    assert np.max(away, axis=0).min() < 0.22


def test_head_and_trunk_go_to_their_sides():
    _, rotations = joints("leans to the left with the head turned to the right")
    chest, head = rotations[:, AT["spine3"]], rotations[:, AT["head"]]
    assert chest[:, 0, 1].max() > 0.25  # its up axis, towards +x, the body's left
    assert (np.arctan2(head[:, 0, 2], head[:, 2, 2]) < -0.5).any()


def test_a_knee_is_lifted_to_the_height_that_is_said():
    positions, _ = joints("lifts the right knee to hip height and holds it")
    assert abs(at(positions, "right_knee")[-1, 1] - at(positions, "right_hip")[-1, 1]) < 0.08
    assert at(positions, "pelvis")[-1, 0] > 0.05  # over the left foot


def test_alternately_is_one_side_after_the_other():
    positions, _ = joints("lifts the knees alternately")
    left, right = (at(positions, f"{side}_knee")[:, 1] for side in ("left", "right"))
    assert left.max() > 0.8 and right.max() > 0.8 and np.minimum(left, right).max() < 0.7


def test_a_gesture_of_the_hands_in_a_stance():
    clap = next(one for one in gestures() if one.name == "clap")
    _, standing = gesture_motion(clap).world()
    _, seated = gesture_motion(in_stance(clap, Stance("chair"))).world()
    assert at(standing, "pelvis")[:, 1].min() > 0.95 and at(seated, "pelvis")[:, 1].max() < 0.7
    for positions in (standing, seated):
        away = np.linalg.norm(at(positions, "left_wrist") - at(positions, "right_wrist"), axis=1)
        assert away.min() < 0.2
    hop = next(one for one in gestures() if one.name == "hop")
    assert in_stance(hop, Stance("chair")) is hop


def test_who_lies_down_sits_before():
    positions, _ = joints("lies down on the back and raises both arms")
    pelvis, head = at(positions, "pelvis")[:, 1], at(positions, "head")[:, 1]
    assert pelvis[0] > 0.95 and (head > 0.5)[pelvis < 0.2].any() and head[-1] < 0.35


def test_a_foot_that_is_held_comes_to_the_hand():
    positions, rotations = joints("holds the left foot with the left hand")
    away = np.linalg.norm(at(positions, "left_wrist") - at(positions, "left_ankle"), axis=1)
    assert away.max() < 0.3 and at(positions, "left_ankle")[:, 1].min() > 0.4
    assert rotations[:, AT["spine3"], 1, 1].min() > 0.75  # upright
