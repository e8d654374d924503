"""A character that never stops, with the shipped weights."""

from itertools import islice

import numpy as np
import pytest

import bunraku
from bunraku.core.body.layout import HANDLE_INDEX
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.files.samples import sample_character
from bunraku.retarget.pins import end_positions, limb_ends

pytestmark = pytest.mark.skipif(
    not (shipped_checkpoint("handles").is_file() and shipped_checkpoint("diffusion").is_file()),
    reason="the shipped weights are missing",
)
HOW = {"seed": 3, "steps": 2}


def roots(live, count):
    return np.concatenate([pose.motion.root_translation for pose in islice(live, count)])


@pytest.fixture(scope="module")
def walked():
    """Six seconds without a word."""
    return roots(bunraku.live(sample_character("person"), "walks forward", **HOW), 120)


def test_windows_join_and_what_is_said_shows_at_once(walked):
    live = bunraku.live(sample_character("person"), "walks forward", **HOW)
    path = roots(live, 50)
    assert np.array_equal(path, walked[:50]) and np.linalg.norm(np.diff(walked, axis=0), axis=1).max() < 0.15
    live.say("waves with the right hand")
    after = roots(live, 40)
    assert np.array_equal(after[:5], walked[50:55]) and not np.array_equal(after[5:10], walked[55:60])
    assert np.linalg.norm(np.diff(after, axis=0), axis=1).max() < 0.15
    played = live.played(2)
    assert len(played.motion) == 40 and np.array_equal(played.motion.root_translation, after)


def test_a_direction_is_taken(walked):
    live = bunraku.live(sample_character("person"), "walks forward", **HOW)
    live.go((1, 0))
    path = roots(live, 120)
    assert walked[-1, 2] > 2 and abs(walked[-1, 0]) < 1
    assert path[-1, 0] - path[40, 0] > 1 and abs(path[-1, 2] - path[60, 2]) < 0.6
    facing = live.played(0.1).motion.root_rotation[-1, :, 2]
    assert facing[0] > 0.8


def test_a_foot_that_stands_where_a_window_ends_stays_there_in_the_next():
    slid = []
    for seed in (1, 2, 3):  # in some dances hardly a foot stands where a window ends
        live = bunraku.live(sample_character("person"), "dances", seed=seed)
        shown = live.window(200)[1]
        posed, legs = shown.vertices(), live._body.anatomy.legs
        for joint in range(39, 199, 40):  # the last frame of each window of two seconds
            for leg in legs:
                foot = posed[joint : joint + 4, leg.foot_area]
                sole = foot[:, (foot[..., 1] - posed[..., 1].min() < 0.01).all(axis=0)]
                if sole.shape[1]:
                    slid.append(np.linalg.norm(np.diff(sole[..., [0, 2]], axis=0), axis=-1).mean(axis=1).max())
    assert len(slid) > 1 and max(slid) < 0.01


def test_what_was_not_shown_is_drawn_anew(walked):
    live = bunraku.live(sample_character("person"), "walks forward", **HOW)
    first, one = live.window(60)
    assert (first, len(one.motion)) == (0, 60)
    live.say("jumps")
    first, two = live.window(30, start=20)  # 40 poses were thrown away
    assert first == 20 and np.array_equal(two.motion.root_translation[:5], walked[20:25])
    with pytest.raises(bunraku.OptionError, match="was not given"):
        live.window(1, start=500)


def test_it_looks_and_reaches_over_what_it_does():
    live = bunraku.live(sample_character("person"), "stands still", **HOW)
    left = [end for end in limb_ends(live._body.anatomy) if end.part == "left_hand"]
    before = live.window(20)[1]
    hung = end_positions(before.motion, before.handles, left)[:, 0]
    arm = left[0].limb
    shoulder = before.motion.transforms(before.handles.positions)[-1, arm.upper]
    goal = shoulder[:, :3] @ arm.joints[0] + shoulder[:, 3] + (0.05, -0.1, 0.3)  # within reach
    live.look((1.5, 1.6, 0.8))
    live.reach(goal)
    asked = live.window(30)[1]
    world = asked.motion.transforms(asked.handles.positions).astype(float)
    head = world[-1, HANDLE_INDEX["head"]]
    toward = np.array([1.5, 1.6, 0.8]) - (head[:, :3] @ asked.handles.positions[HANDLE_INDEX["head"]] + head[:, 3])
    assert head[:, 2] @ toward / np.linalg.norm(toward) > np.cos(np.radians(8))
    hand = end_positions(asked.motion, asked.handles, left)[:, 0]
    assert np.linalg.norm(hand[-1] - goal) < 0.03
    assert np.linalg.norm(np.diff(np.concatenate([hung, hand]), axis=0), axis=1).max() < 0.15  # it does not leap there
    live.look(None)
    live.reach(None)
    live.window(40, start=50)
    shown, drawn = live.played(0.5), live._shown.take(slice(80, 90))
    np.testing.assert_allclose(shown.motion.rotations, drawn.motion.rotations, atol=5e-3)
    assert len(live.played(9, stop=33).motion) == 33
    for wrong in ((1, 2), "there", (1, 2, float("nan"))):
        with pytest.raises(bunraku.OptionError, match="a point is"):
            live.look(wrong)


def test_what_is_refused_changes_nothing_and_what_is_over_stops():
    live = bunraku.live(sample_character("person"), "walks forward", ahead=True, **HOW)
    for wrong in ("blorg zint", ""):
        with pytest.raises(bunraku.OptionError):
            live.say(wrong)
    for wrong in ((0, 0), (1,), "north", (float("nan"), 1)):
        with pytest.raises(bunraku.OptionError, match="a direction is"):
            live.go(wrong)
    with live:
        assert len(list(islice(live, 50))) == 50
    assert list(live) == []


def test_memory_stays_flat(monkeypatch):
    monkeypatch.setattr("bunraku.pipelines.live.KEPT", 1.0)
    live = bunraku.live(sample_character("person"), "walks forward", **HOW)
    lengths = []
    for _ in range(6):
        roots(live, 40)
        lengths.append(len(live._shown.motion))
    assert max(lengths) <= 20 + 60 and live.window(1)[0] == 240
