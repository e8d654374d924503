"""Gestures as they are performed: no two alike, counts kept, hands that touch still touching, feet planted."""

import numpy as np
import pytest

from bunraku.body.layout import JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.diffusion.examples.pack import load_examples
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.gestures.catalogue import gestures
from bunraku.gestures.manner import Manner
from bunraku.gestures.perform import performed
from bunraku.gestures.play import posed
from bunraku.gestures.pose import Pose
from bunraku.gestures.standing import AT, captured, stands_well, swaying
from bunraku.gestures.tracks import Tracks


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


@pytest.mark.parametrize("name", ["clap", "wave", "sit", "salute", "knock", "nod"])
def test_no_two_are_alike_and_the_same_seed_gives_the_same(name):
    first, again, other = (world(name, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.linalg.norm(first - other, axis=-1).max() > 0.03
    speed = np.linalg.norm(np.diff(first[:, 0], axis=0), axis=-1)
    assert speed.max() > 1e-4  # the pelvis is never frozen


def test_hands_that_touch_still_touch_whatever_the_size():
    for seed in range(8):
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
    for frames in (20, 90, 196):
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
