"""The gestures of the catalogue, and the parts of the body that perform them."""

import numpy as np
import pytest
from palms import palms as both_palms

from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.errors import FormatError
from bunraku.generation.features import body_handle_motion
from bunraku.gestures.catalogue import STANDING, at_part, gesture_of, gestures, part_in, read_gestures, read_parts
from bunraku.gestures.perform import performed
from bunraku.gestures.play import AT, gesture_motion
from bunraku.gestures.pose import HANGING, Gesture, Hand, Pose, Repeat, again, foot_on, through
from bunraku.language.lexicon import actions_of, lexicon
from bunraku.language.understood import understood

JOINT_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
WHIPS = ("throw", "pitch", "tennis", "serve")
KNEELING = ("kneel", "both knees", "propose")
CROSSED = ("cross legs",)


def palms(motion):
    """Middle of each palm by its side, shape (N, 3) each."""
    return dict(zip(("left", "right"), both_palms(motion).swapaxes(0, 1), strict=True))


def gesture(name):
    return next(one for one in gestures() if one.name == name)


def test_a_palm_is_where_its_key_says_and_faces_that_way():
    hand = Hand((0.2, 1.4, 0.4), (0, 1, 0), (0, 0, 1))
    motion = gesture_motion(Gesture("stop", (), ((0.0, Pose()), (1.0, Pose(right=hand)), (2.0, Pose()))))
    rotations, _ = motion.world()
    there = palms(motion)
    sway = 0.03  # the chest moves while somebody stands
    np.testing.assert_allclose(there["right"][20], [-0.2, 1.4, 0.4], atol=sway)
    np.testing.assert_allclose(there["left"][20], [0.27, 0.845, 0.06], atol=sway)
    assert rotations[20, JOINT_AT["right_wrist"]][:, 1] @ [0, 0, -1] > 0.95  # the back of a hand at rest is up
    assert np.ptp(there["right"], axis=0)[1] > 0.5 > np.ptp(there["left"], axis=0)[1] * 10


def test_claps_meet_and_part_as_often_as_said():
    motion = gesture_motion(gesture("clap"))
    there = palms(motion)
    away = np.linalg.norm(there["left"] - there["right"], axis=1)
    near = (away[1:-1] < away[:-2]) & (away[1:-1] <= away[2:]) & (away[1:-1] < 0.08)
    assert near.sum() == 8 and away[16:-16].max() > 0.2


@pytest.mark.parametrize("number", range(len(gestures())), ids=lambda number: f"{gestures()[number].name}-{number}")
def test_every_gesture_is_whole(number):
    one = gestures()[number]
    if lexicon().actions[one.name].said:  # else it is the reader that names it
        assert {actions_of(text) for text in one.texts} == {(one.name,)}
        for text in one.texts:
            found = understood(text)
            assert found.ok and not found.unknown
    motion = gesture_motion(one)
    rotations, positions = motion.world()
    assert len(motion) == round(20 * one.seconds) + 1
    np.testing.assert_allclose(np.linalg.det(rotations.reshape(-1, 3, 3)), 1, atol=1e-5)
    for side in ("left", "right"):
        ankle = positions[:, JOINT_AT[f"{side}_ankle"]]
        assert ankle[:, 1].min() > 0.07
        if one.name not in (*KNEELING, *CROSSED, "tie shoes", "hop") and not one.steps:
            assert np.ptp(ankle, axis=0).max() < 0.01  # feet stand, however the pelvis sways
        fastest = 0.65 if one.name in WHIPS else 0.45  # 9 m/s, a fast punch, and 13 of who throws
        assert np.linalg.norm(np.diff(palms(motion)[side], axis=0), axis=1).max() < fastest
    if not one.steps:
        stands = {"stand up": (-1,), "sit": (0,)} | dict.fromkeys((*KNEELING, *CROSSED), (0,))
        ends = [palms(motion)["right"][frame] for frame in stands.get(one.name, (0, -1))]
        np.testing.assert_allclose(ends, [[-0.27, 0.845, 0.06]] * len(ends), atol=0.05)
    if one.cycle is not None:
        start, stop = (round(20 * moment) for moment in one.cycle)
        assert 12 <= stop - start < len(motion)
        goes = [one.repeat is not None and one.repeat.drift[0] != 0, 0, 1]  # some go on meanwhile
        hand = palms(motion)["right"] - positions[:, 0] * goes
        assert np.linalg.norm(hand[stop] - hand[start]) < 0.04  # all but the sway


def test_who_ties_a_shoe_kneels_with_both_hands_at_it():
    _, positions = gesture_motion(gesture("tie shoes")).world()
    there = positions[50:80]
    assert (there[:, [JOINT_AT["left_knee"], JOINT_AT["right_knee"]], 1].min(axis=1) < 0.15).all()
    for hand in ("left_wrist", "right_wrist"):
        assert np.linalg.norm(there[:, JOINT_AT[hand]] - there[:, JOINT_AT["left_ankle"]], axis=1).max() < 0.42


def test_who_kneels_has_a_knee_on_the_ground_and_both_where_so_said():
    for name, count in (("kneel", 1), ("both knees", 2)):
        _, positions = gesture_motion(gesture(name)).world()
        knees = positions[-1, [JOINT_AT["left_knee"], JOINT_AT["right_knee"]], 1]
        assert (knees < 0.12).sum() == count and knees.min() > 0.02


def test_who_sits_has_the_feet_on_the_ground_and_the_thighs_level():
    for name, seated in (("sit", -1), ("stand up", 0)):
        rotations, positions = gesture_motion(gesture(name)).world()
        pelvis, knee, ankle = (positions[seated, JOINT_AT[part]] for part in ("left_hip", "left_knee", "left_ankle"))
        assert abs(pelvis[1] - knee[1]) < 0.1 and knee[2] - pelvis[2] > 0.3 and abs(knee[2] - ankle[2]) < 0.1
        assert rotations[seated, JOINT_AT["spine3"]][1, 1] > 0.95  # upright
        assert positions[-1 - seated, 0, 1] - positions[seated, 0, 1] > 0.35
        heights = lowest_of(gesture_motion(gesture(name)))
        assert heights.min() > -0.02 and heights.max() < 0.03


def test_who_sits_with_crossed_legs_has_each_foot_on_the_other_side_or_a_knee_over_the_other():
    floor, chair = (gesture_motion(found) for found in gestures() if found.name == "cross legs")
    _, positions = floor.world()
    left, right = (positions[-1, JOINT_AT[f"{side}_ankle"]] for side in ("left", "right"))
    assert left[0] < 0 < right[0] and positions[-1, 0, 1] < 0.2  # the left foot is on the right, and so the other way
    knees = positions[-1, [JOINT_AT["left_knee"], JOINT_AT["right_knee"]]]
    assert knees[0, 0] > 0.3 and knees[1, 0] < -0.3
    assert abs(lowest_of(floor)[-1]) < 0.02
    _, positions = chair.world()
    assert positions[-1, JOINT_AT["right_ankle"], 0] > positions[-1, JOINT_AT["left_ankle"], 0]
    assert positions[-1, JOINT_AT["right_knee"], 1] > positions[-1, JOINT_AT["left_knee"], 1] + 0.05
    assert 0.5 < positions[-1, 0, 1] < 0.65


@pytest.mark.parametrize("name", ["sweep", "hoe", "dig"])
def test_both_hands_hold_a_shaft_that_goes_to_and_fro(name):
    there = palms(gesture_motion(gesture(name)))
    away = np.linalg.norm(there["left"] - there["right"], axis=1)[30:-30]
    assert away.min() > 0.15 and away.max() < 0.5
    middle = (there["left"] + there["right"])[30:-30] / 2
    assert np.ptp(middle, axis=0).max() > 0.3  # to a side, or up and down


def test_who_cycles_pedals_with_one_foot_down_while_the_other_is_up():
    _, positions = gesture_motion(gesture("cycle")).world()
    left, right = (positions[:, JOINT_AT[f"{side}_ankle"], 1] for side in ("left", "right"))
    assert np.ptp(left) > 0.3 and np.corrcoef(left, right)[0, 1] < -0.95
    assert ((left[1:] > left.mean()) & (left[:-1] <= left.mean())).sum() >= 5


def test_a_raised_arm_is_far_above_the_head_and_the_other_hangs():
    one, two = (palms(gesture_motion(found)) for found in gestures() if found.name == "raise arm")
    assert one["right"][40, 1] > 1.95 and one["left"][40, 1] < 0.9
    assert min(two["right"][40, 1], two["left"][40, 1]) > 1.95


def test_a_punch_goes_straight_ahead_and_the_other_fist_stays_up():
    there = palms(gesture_motion(gesture("punch")))
    reach = there["right"][:, 2]
    assert reach.max() > 0.65 and (there["left"][10:, 1] > 1.3).all()
    assert ((reach[1:] > 0.5) & (reach[:-1] <= 0.5)).sum() == 4


def test_who_hops_is_in_the_air_with_both_feet_and_lands_on_one():
    _, positions = gesture_motion(gesture("hop")).world()
    right, left = (positions[20:60, JOINT_AT[f"{side}_ankle"], 1] for side in ("right", "left"))
    assert left.min() > 0.35 and right.min() < 0.1 and right.max() > 0.2


def test_both_hands_hold_the_club():
    there = palms(gesture_motion(gesture("golf")))
    assert np.linalg.norm(there["left"] - there["right"], axis=1)[16:70].max() < 0.2


def lowest_of(motion):
    """Height of what is nearest to the ground in each frame, shape (N,) [m]."""
    body = reference_body()
    return reference_anatomy().surface_reach.lowest(body_handle_motion(motion).transforms(body.handles.positions))


@pytest.mark.parametrize("name", ["march in place", "zombie", "push-up", "sit-up", "crawl", "box", "throw", "tennis"])
def test_nobody_hovers_or_sinks_in(name):
    heights = lowest_of(gesture_motion(gesture(name)))
    assert heights.min() > -0.01 and heights.max() < 0.025


def test_who_leaves_the_ground_comes_back_to_it():
    for name, high in (("skip", 0.05), ("run in place", 0.0), ("jump over", 0.4)):
        heights = lowest_of(gesture_motion(gesture(name)))
        assert heights.min() > -0.03 and heights.max() > high
        assert (heights < 0.03).mean() > 0.5 and heights.max() < 0.8


def test_who_steps_on_the_spot_stays_there_and_lifts_one_knee_after_the_other():
    _, positions = gesture_motion(gesture("march in place")).world()
    assert np.ptp(positions[:, 0], axis=0)[[0, 2]].max() < 0.1
    knees = positions[:, [JOINT_AT["left_knee"], JOINT_AT["right_knee"]], 1] > 0.85
    assert knees[:, 0].any() and knees[:, 1].any() and not knees.all(axis=1).any()


@pytest.mark.parametrize("name", ["zombie", "skip", "stumble", "throw"])
def test_feet_that_are_down_do_not_slide(name):
    motion = gesture_motion(gesture(name))
    _, positions = motion.world()
    assert positions[-1, 0, 2] - positions[0, 0, 2] > 0.5
    for side in ("left", "right"):
        ball = positions[:, JOINT_AT[f"{side}_foot"]]
        down = (ball[1:, 1] < 0.032) & (ball[:-1, 1] < 0.032)
        assert down.mean() > 0.2
        assert np.linalg.norm(np.diff(ball[:, [0, 2]], axis=0), axis=1)[down].max() < 0.04


def test_hands_on_the_ground_stay_where_they_are():
    for name, share in (("push-up", 0.95), ("crawl", 0.5)):
        hand = palms(gesture_motion(gesture(name)))["right"]
        still = np.linalg.norm(np.diff(hand, axis=0), axis=1) < 0.002
        assert still.mean() >= share and hand[:-1][still][:, 1].max() < 0.06


def test_who_does_sit_ups_lies_on_the_back_and_comes_up_to_the_knees():
    rotations, positions = gesture_motion(gesture("sit-up")).world()
    chest = rotations[:, JOINT_AT["spine3"]][:, 1, 1]  # of the upper body's axis, how far it is up
    assert chest.min() < 0.2 and chest.max() > 0.85
    assert np.ptp(positions[:, JOINT_AT["left_ankle"]], axis=0).max() < 0.01 and positions[:, 0, 1].max() < 0.2


def test_who_climbs_begins_on_the_ground_and_gets_up_in_rungs():
    for one in (one for one in gestures() if one.name == "ladder"):
        motion = gesture_motion(one)
        _, positions = motion.world()
        up = positions[:, 0, 1] - positions[0, 0, 1]
        assert up[-1] > 1.5 and np.diff(up).min() > -0.002
        assert up[-1] % 0.6 == pytest.approx(0.0, abs=0.01) or up[-1] % 0.6 == pytest.approx(0.6, abs=0.01)
        assert positions[0, JOINT_AT["left_ankle"], 1] == pytest.approx(0.081, abs=0.01)
        assert np.abs(np.diff(up)[-2:]).max() < 0.01  # at rest


def test_a_throw_ends_its_whip_in_front_of_the_body():
    motion = gesture_motion(gesture("throw"))
    _, positions = motion.world()
    ahead = palms(motion)["right"][:, 2] - positions[:, 0, 2]
    speed = np.linalg.norm(np.diff(palms(motion)["right"], axis=0), axis=1) * 20
    fastest = int(speed.argmax())
    assert ahead[: fastest - 2].min() < -0.15 and ahead[fastest : fastest + 6].max() > 0.4
    assert 5 < speed.max() < 13


def test_what_flows_passes_through_its_keys_and_stays_where_two_are_alike():
    one, other = Pose(lean=(0, 0, 0)), Pose(lean=(20, 0, 0))
    keys = through([(0.0, one), (0.5, other), (1.0, other), (1.5, one)])
    assert len(keys) == 31 and [time for time, _ in keys[:3]] == [0.0, 0.05, 0.1]
    lean = np.array([pose.lean[0] for _, pose in keys])
    np.testing.assert_allclose(lean[[0, 10, 20, 30]], [0, 20, 20, 0], atol=1e-9)
    np.testing.assert_allclose(lean[10:21], 20, atol=1e-9)


@pytest.mark.parametrize("pitch", [-20.0, 0.0, 30.0, 60.0])
def test_a_foot_rolls_over_its_ball_and_its_heel(pitch):
    bent = Pose(hips=(0, -0.15, 0), left_foot=foot_on(0.12, 0.2, pitch))
    motion = gesture_motion(Gesture("step", (), ((0.0, Pose()), (1.0, bent))))
    rotations, positions = motion.world()
    flat = [positions[-1, JOINT_AT["left_ankle"]][2], positions[-1, JOINT_AT["left_foot"]][2]]
    if pitch >= 0:
        assert positions[-1, JOINT_AT["left_foot"], 1] == pytest.approx(0.027, abs=0.006)
        assert flat[1] == pytest.approx(0.355, abs=0.012)
    else:
        heel = positions[-1, JOINT_AT["left_ankle"]] + rotations[-1, JOINT_AT["left_ankle"]] @ [0, -0.081, -0.05]
        assert heel[1] == pytest.approx(0.0, abs=0.005) and heel[2] == pytest.approx(0.15, abs=0.01)


def test_standing_goes_on_without_a_stop():
    motion = gesture_motion(STANDING)
    _, positions = motion.world()
    assert 0.004 < np.ptp(positions[:, 0], axis=0).max() < 0.03
    assert len(motion) > 180 and np.ptp(positions[:, JOINT_AT["head"]], axis=0).max() > 0.01


def test_cycles_are_laid_evenly_between_two_rests():
    one, other = Pose(lean=(1, 0, 0)), Pose(lean=(2, 0, 0))
    keys, cycle = again([one, other], 0.5, 3, start=0.6, end=0.4)
    assert [round(time, 3) for time, _ in keys] == [0.0, 0.6, 0.85, 1.1, 1.35, 1.6, 1.85, 2.1, 2.5]
    assert keys[0][1].right == keys[-1][1].right == HANGING and keys[1][1] is one and keys[2][1] is other
    assert cycle == Repeat(0.6, 0.5, 3)


def test_both_arms_keep_their_bones():
    body = reference_body()
    _, positions = gesture_motion(gesture("violin")).world()
    for side in ("left", "right"):
        for one, two in ((f"{side}_shoulder", f"{side}_elbow"), (f"{side}_elbow", f"{side}_wrist")):
            length = np.linalg.norm(positions[:, JOINT_AT[one]] - positions[:, JOINT_AT[two]], axis=1)
            np.testing.assert_allclose(
                length, np.linalg.norm(body.joints[JOINT_AT[one]] - body.joints[JOINT_AT[two]]), atol=1e-4
            )


ROWS = """
[hands]
up = {palm = [0.2, 2.0, 0.1], fingers = [0, 1, 0]}
[poses]
rest = {}
[frames.step]
pose = {right = "up", feet = {ground = [0.1, 0.0]}}
hips = [[0, 0, 0], [0, 0, 0.1], [0, 0, 0.2]]
left_foot.pitch = [0, 10, 0]
[[gesture]]
name = "salute"
texts = ["salutes"]
keys = [[0, "rest"], [1.5, "there"]]
feet.ahead = {ground = [0.1, 0.3], turn = 0}
poses.there = {hands = "up", left_foot = "ahead", head = [5, 0, 0]}
[[gesture]]
name = "walk"
texts = ["walks"]
frames = {of = "step", loop = [0, 2], times = 2, drift = [0, 0, 0.2]}
cycle = [0, 0.2]
steps = true
"""


def test_a_row_of_the_file_is_a_gesture(tmp_path):
    (tmp_path / "rows.toml").write_text(ROWS)
    salute, walk = read_gestures(tmp_path / "rows.toml")
    hand = Hand((0.2, 2.0, 0.1), (0, 1, 0))
    there = Pose(hand, hand, head=(5, 0, 0), left_foot=foot_on(0.1, 0.3, turn=0))
    assert salute == Gesture("salute", ("salutes",), ((0, Pose()), (1.5, there)))
    assert [time for time, _ in walk.keys] == [0.0, 0.05, 0.1, 0.15, 0.2] and walk.steps and walk.cycle == (0, 0.2)
    np.testing.assert_allclose([pose.hips[2] for _, pose in walk.keys], [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose([pose.left_foot.ankle[2] for _, pose in walk.keys], [0, 0, 0.2, 0.2, 0.2])
    assert [pose.left_foot.pitch for _, pose in walk.keys] == [0, 10, 0, 10, 0]


@pytest.mark.parametrize(
    ("wrong", "right"), [('"there"]]', '"nowhere"]]'), ("hands = ", "hand = "), ('of = "step"', 'of = "stride"')]
)
def test_a_wrong_row_is_named(tmp_path, wrong, right):
    (tmp_path / "rows.toml").write_text(ROWS.replace(wrong, right))
    with pytest.raises(FormatError, match=r"rows.toml: gesture '(salute|walk)' is wrong at "):
        read_gestures(tmp_path / "rows.toml")


def test_who_brushes_the_hair_strokes_it_from_the_top_down_beside_the_head():
    motion = gesture_motion(gesture("brush hair"))
    _, positions = motion.world()
    hand = palms(motion)["right"][16:-12] - positions[16:-12, JOINT_AT["head"]]
    assert np.ptp(hand[:, 1]) > 0.25 and np.linalg.norm(hand, axis=1).max() < 0.4
    assert ((hand[1:-1, 1] < hand[:-2, 1]) & (hand[1:-1, 1] <= hand[2:, 1])).sum() == 3


def test_a_gesture_alone_is_read_as_it_is_among_all():
    first = {one.texts: one for one in reversed(gestures())}  # a ladder is climbed in three lengths
    for texts, one in first.items():
        assert gesture_of(texts) == one
    assert gesture_of(()) is None and gesture_of(("nobody tells this",)) is None


def test_who_looks_aside_turns_the_head_to_the_right_and_who_looks_up_raises_the_face():
    def face(name):
        rotations, _ = gesture_motion(gesture(name)).world()
        return rotations[:, JOINT_AT["head"]] @ [0, 0, 1]

    aside, up = face("look aside"), face("look up")
    assert np.degrees(np.arctan2(-aside[:, 0], aside[:, 2])).max() > 50 and aside[:, 0].max() < 0.1
    assert up[:, 1].max() - up[0, 1] > 0.5


def test_who_balances_stands_on_the_right_foot_below_the_pelvis():
    _, positions = gesture_motion(gesture("balance")).world()
    there = positions[30:90]
    assert (there[:, JOINT_AT["left_ankle"], 1] - there[:, JOINT_AT["right_ankle"], 1]).min() > 0.3
    assert np.abs(there[:, 0, 0] - there[:, JOINT_AT["right_ankle"], 0]).max() < 0.07


def test_who_ducks_goes_down_at_once_and_who_pushes_does_so_with_both_hands():
    _, positions = gesture_motion(gesture("duck")).world()
    head = positions[:, JOINT_AT["head"], 1]
    assert head[0] - head[8:24].max() > 0.5 and abs(head[-1] - head[0]) < 0.03
    motion = gesture_motion(gesture("push"))
    there = palms(motion)
    for side in ("left", "right"):
        assert there[side][45, 2] - there[side][15, 2] > 0.25 and there[side][45, 1] > 1.2


@pytest.mark.parametrize("seed", range(4))
def test_who_hops_to_the_right_stands_between_hops_and_goes_on_to_the_right(seed):
    one = next(one for one in gestures() if "hops to the right" in one.texts)
    motion = performed(one, 100, [], np.random.default_rng(seed))
    _, positions = motion.world()
    feet = positions[:, [JOINT_AT["left_ankle"], JOINT_AT["right_ankle"]]]
    assert np.linalg.norm(feet[:, 0] - feet[:, 1], axis=1).max() < 0.4  # both go the same way
    assert motion.root_translation[-1, 0] < -1
    speed = np.linalg.norm(np.diff(feet.mean(axis=1)[:, [0, 2]], axis=0), axis=1) * 20
    assert (speed < 0.15).mean() > 0.3 and speed.max() > 0.8


def wrist_from(name, part, joint):
    """Distance of the right wrist from a joint in the midst of a gesture at a part [m]."""
    one = at_part(gesture(name), part)
    positions = gesture_motion(one).world()[1]
    middle = slice(round(20 * 1.0), round(20 * (one.seconds - 0.9)))
    return np.linalg.norm(positions[middle, AT["right_wrist"]] - positions[middle, AT[joint]], axis=1)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("scratches his chin", "chin"),
        ("touches the back of the head", "back-head"),
        ("touches the back", "back"),
        ("a person rubs the back of her neck", "back-neck"),
        ("pats his left knee", "knee"),
    ],
)
def test_the_longest_words_name_the_part(text, name):
    found = part_in(text)
    assert found is not None and found.name == name
    assert set(found.words) <= set(text.split())


def test_nothing_is_named_that_no_hand_reaches():
    assert part_in("scratches the door") is None
    assert part_in("touches the toes") is None


@pytest.mark.parametrize("name", ["scratch", "touch", "rub"])
def test_the_hand_is_at_the_part(name):
    assert wrist_from(name, "knee", "right_knee").max() < 0.25 < wrist_from(name, "knee", "head").min()
    assert wrist_from(name, "shoulder", "left_shoulder").max() < 0.3
    assert wrist_from(name, "chin", "neck").max() < 0.3
    assert wrist_from(name, "thigh", "right_hip").max() < 0.45


def test_it_moves_along_the_surface_and_rests_before_and_after():
    own, chin = gesture("scratch"), at_part(gesture("scratch"), "chin")
    assert chin.keys[0][1] == chin.keys[-1][1] == Pose()
    assert [time for time, _ in chin.keys] == [time for time, _ in own.keys]
    moved = np.subtract(chin.keys[1][1].right.palm, chin.keys[2][1].right.palm)
    before = np.subtract(own.keys[1][1].right.palm, own.keys[2][1].right.palm)
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(before))
    out = np.array(chin.keys[1][1].right.faces) / np.linalg.norm(chin.keys[1][1].right.faces)
    assert abs(moved @ out) < 0.6 * np.linalg.norm(moved)


def test_every_part_can_be_reached():
    for name in read_parts():
        positions = gesture_motion(at_part(gesture("touch"), name)).world()[1]
        there = at_part(gesture("touch"), name).keys[1][1].right
        frame = round(20 * 0.8)
        if there.on == "chest":  # which hardly moves: the palm is 9 cm from the wrist
            palm = np.array(there.palm) * [-1, 1, 1]
            assert np.linalg.norm(positions[frame, AT["right_wrist"]] - palm) < 0.16, name
