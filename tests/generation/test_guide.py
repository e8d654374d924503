"""Guidance examples: how the sampler starts from captured and performed motion."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.generation.composition import SLOWED, at_once, on_one_leg, unturned, warped
from bunraku.generation.features import FeatureStatistics, decode, mirror
from bunraku.generation.guide import (
    GuidanceExamples,
    circled,
    fits_into,
    goes_on,
    laid,
    laid_script,
    repeated,
    times_in,
)
from bunraku.generation.networks import Networks, Texts
from bunraku.generation.pack import ExamplePack
from bunraku.generation.retrieve import Found, Retrieved
from bunraku.generation.verifier import BEGUN, Track, onset
from bunraku.language.parse import clause_of, parse
from bunraku.language.posing import Manner
from bunraku_lab.datasets.motions.clips import packed_stretch

WAVE, KICK = Found(0, False, 0.9), Found(1, False, 0.9)


@pytest.fixture
def units(pack):
    return FeatureStatistics.measure([pack.features(0), pack.features(1)])


def lay(pack, units, found, frames):
    return units.restore(laid(pack, found, frames, units, np.random.default_rng(0)).values)


def test_what_goes_on_is_played_on_or_cut(pack, units):
    long, short = (lay(pack, units, WAVE, frames) for frames in (100, 25))
    assert len(long) == 100 and len(short) == 25
    step = np.abs(np.diff(pack.features(0), axis=0)).max()
    assert np.abs(np.diff(long, axis=0)).max() < 1.1 * step
    assert np.abs(np.diff(long[-30:], axis=0)).max() > 0.5 * step  # it waves to the end


def test_what_is_to_be_done_once_has_rest_around_it(pack, units):
    guide = laid(pack, KICK, 100, units, np.random.default_rng(0), Manner(count=1))
    long, kick = units.restore(guide.values), pack.features(1)
    moving = np.flatnonzero(np.abs(np.diff(long[:, 3:], axis=0)).max(axis=1) > 1e-4)
    assert moving[0] <= 5 and 22 <= moving[-1] - moving[0] <= 38
    np.testing.assert_allclose(np.ptp(long[:, 3:], axis=0).max(), np.ptp(kick[:, 3:], axis=0).max(), rtol=0.02)
    np.testing.assert_allclose(long[-1, :3], 0, atol=1e-3)


def test_an_example_fills_its_time(pack, units):
    """What is done once is done again where a body would rest for too long, unless it ends at another height."""
    kick, sits = pack.features(1), pack.features(1).copy()
    sits[:, 3] -= np.linspace(0, 0.5, len(sits))
    assert [times_in(frames, kick, SLOWED, ["kick"]) for frames in (25, 60, 120, 190)] == [1, 1, 2, 4]
    assert times_in(120, kick, SLOWED, ["clap"]) == 4 and times_in(120, sits, SLOWED, ["kick"]) == 1
    standing = np.repeat(kick[:1], 60, axis=0)
    skeleton = skeleton_from_handles(decode(standing))
    stands = replace(pack.examples[1], name="stand", texts=(), frames=60)
    data = (*pack.data, packed_stretch(skeleton.root_translation, skeleton.rotations))
    with_rest = replace(pack, examples=(*pack.examples, stands), data=data)
    for seed in range(3):
        guide = laid(with_rest, KICK, 196, units, np.random.default_rng(seed))
        moving = np.flatnonzero(np.abs(np.diff(units.restore(guide.values)[:, 3:], axis=0)).max(axis=1) > 1e-2)
        assert len(guide.values) == 196 and (196 - moving[-1]) / 20 < 1.5 and np.diff(moving).max() / 20 < 1.5


def test_what_is_not_to_turn_is_straightened(pack):
    turning = pack.features(0).copy()
    turning[:, 0] = np.where(np.arange(len(turning)) < 10, 3.0, 0.0)
    straight = unturned(turning, 20.0)
    assert straight[:, 0].sum() / 20 == pytest.approx(np.radians(20))
    assert np.abs(straight[30:, 0]).max() < 0.05 and np.array_equal(straight[:, 1:], turning[:, 1:])
    jerk = np.zeros((5, 271), np.float32)
    jerk[:, 0] = 0, 0, 0, 30, -6  # its mean over time goes the other way
    assert unturned(jerk, 20.0)[:, 0].sum() / 20 == pytest.approx(np.radians(20))


def test_what_waits_before_it_begins_does_not_where_its_time_can_still_be_filled(pack):
    wave = np.concatenate([pack.features(0)] * 2)
    waits = wave[:1].repeat(25, axis=0)
    waits[:, :3] = 0
    late = np.concatenate([waits, wave])
    script = [(clause_of("someone waves"), len(late))]
    soon = at_once(late, script, 20.0)
    begins = [onset(Track.of(decode(features))) for features in (late, soon)]
    assert len(soon) == len(late) and begins[0] > 1.2 and begins[1] <= BEGUN
    assert np.array_equal(at_once(soon, script, 20.0), soon)
    still = [(clause_of("someone stands still"), len(late))]
    assert np.array_equal(at_once(late, still, 20.0), late)


def test_around_what_stops_in_midmotion_the_sampler_is_left_to_itself(pack, units):
    walk = pack.features(0).copy()
    walk[:, 2] = 1.2
    skeleton = skeleton_from_handles(decode(walk))
    data = (packed_stretch(skeleton.root_translation, skeleton.rotations), pack.data[1])
    cut = replace(pack, examples=(replace(pack.examples[0], loop=None), pack.examples[1]), data=data)
    guide = laid(cut, WAVE, 100, units, np.random.default_rng(0))
    led = np.flatnonzero(guide.share == 1)
    assert 40 <= len(led) <= 50 and (np.diff(led) == 1).all()
    assert guide.share[0] == 1 and guide.share[-1] == 0 and np.abs(np.diff(guide.share)).max() < 0.2
    assert (laid(pack, KICK, 100, units, np.random.default_rng(0)).share == 1).all()  # it can be held


def test_who_goes_on_does_not_stand_before_or_after(pack, units):
    """What could be held is left to the sampler where the sentence says that it lasts."""
    guide = laid(pack, KICK, 100, units, np.random.default_rng(0), Manner(lasts=True))
    led = np.flatnonzero(guide.share == 1)
    assert led[0] == 0 and len(led) == 30 and guide.share[-1] == 0
    walk = replace(pack, examples=(replace(pack.examples[0], loop=None), pack.examples[1]))
    guide = laid(walk, WAVE._replace(close=True), 100, units, np.random.default_rng(0), Manner(lasts=True))
    assert (guide.share == 1).all()  # its steps come round again
    examples = GuidanceExamples(pack, {})
    for sentence, lasts in (
        ("a person walks backward", True),
        ("a person waves", False),
        ("a person walks and stops", False),
    ):
        clause = clause_of(sentence)
        examples._retrieved = {clause.text: Retrieved([KICK])}
        assert examples.of([(clause, 100)], (0, 0), 0).manners[0].lasts is lasts


def test_what_is_done_once_is_sped_up_a_little_but_never_cut(pack, units):
    short = lay(pack, units, KICK, 25)
    np.testing.assert_allclose(short[[0, -1], 3:], pack.features(1)[[0, -1], 3:], atol=1e-4)
    assert fits_into(pack, KICK, 25) and not fits_into(pack, KICK, 20)
    assert fits_into(pack, WAVE, 5)


def test_who_hurries_gets_as_far():
    walk = np.zeros((41, 271), np.float32)
    walk[:, 2] = 1.5
    fast = warped(walk, 31)
    assert fast[1:, 2].sum() == pytest.approx(walk[1:, 2].sum(), rel=1e-6)


def test_the_mirror_image_is_one(pack, units):
    left = laid(pack, WAVE, 40, units, np.random.default_rng(3))
    right = laid(pack, Found(0, True, 0.9), 40, units, np.random.default_rng(3))
    np.testing.assert_allclose(units.restore(right.values), mirror(units.restore(left.values)), atol=1e-4)


def test_sentences_without_an_example_are_the_samplers_own(pack, units):
    guide = laid_script(pack, [(WAVE, 60), (None, 50)], 110, units, np.random.default_rng(0))
    assert guide.values.shape == (110, 271)
    assert (guide.share[60:] == 0).all() and (guide.share[:50] == 1).all()
    assert (np.diff(guide.share[50:60]) < 0).all()


def test_other_seeds_and_candidates_take_others_and_the_same_ones_the_same(pack):
    axes = np.eye(4)
    examples = GuidanceExamples(
        pack,
        {
            "someone waves": (clause_of("someone waves"), (axes[0] + axes[2]) / 2**0.5),
            "jumps": (clause_of("jumps"), 0.8 * axes[1] + 0.6 * axes[3]),
        },
    )
    script = [(clause_of("someone waves"), 60)]
    first, second, again = (examples.of(script, (7, 0), number) for number in (0, 1, 0))
    assert first == again and first.seed != second.seed and first.found == second.found
    others = examples.of(script, (7, 0), 0, 0).found[0]  # where none of its own did what was asked
    assert {first.found[0].mirrored, others.mirrored} == {False, True}
    for seed in range(0, 20, 2):  # seeds in a row share no example
        assert {examples.of(script, (seed, row), 0).found[0].mirrored for row in (0, 1)} == {False, True}
    assert examples.of([(clause_of("jumps"), 60)], (7, 0), 0) is None


def test_the_next_sentence_takes_what_begins_as_the_last_one_ends(pack, monkeypatch):
    monkeypatch.setattr("bunraku.generation.guide.NEAREST", 1)
    low = pack.features(1).copy()
    low[:, 3] -= 0.5
    skeleton = skeleton_from_handles(decode(low))
    data = (*pack.data, packed_stretch(skeleton.root_translation, skeleton.rotations))
    axes = np.eye(4)
    more = ExamplePack(
        (*pack.examples, replace(pack.examples[1], name="low")), data, np.array([0, 0, 1, 2]),
        np.stack([axes[[0, 0, 1, 1]], axes[[2, 2, 3, 3]]]), np.stack([axes[[0, 1, 1]], axes[[2, 3, 3]]]), "none",
    )  # fmt: skip
    examples = GuidanceExamples(
        more, {verb: (clause_of(verb), axes[number]) for number, verb in enumerate(("someone waves", "someone kicks"))}
    )
    script = [(clause_of("someone waves"), 40), (clause_of("someone kicks"), 40)]
    assert {examples.of(script, (seed, 0), 0).found[1].number for seed in range(20)} == {1}


def test_the_crouch_before_a_jump_is_not_held_but_a_seat_and_the_floor_are(pack, units):
    def around(first, last):
        values = pack.features(1).copy()
        values[:, 3] = np.interp(np.arange(30), [5, 24], [first, last])

        class Known(ExamplePack):
            def features(self, position):
                return values

        sits = replace(pack.examples[1], texts=("a person sits down",))
        known = Known(**{**vars(pack), "examples": (pack.examples[0], sits)})
        share = laid(known, KICK, 100, units, np.random.default_rng(0)).share
        return bool(share[-1] == 1)

    ends = [(0.0, 0.0), (-0.25, -0.25), (-0.4, 0.0), (0.0, -0.4), (-0.6, -0.6)]
    assert [around(*pair) for pair in ends] == [True, False, True, True, True]


def test_the_height_of_a_kick_is_joined_to_standing_and_none_of_the_kick_is_lost(pack, units):
    kick = pack.features(1)
    high = 5 + int(np.abs(np.diff(kick[5:25], axis=0)).sum(1).cumsum().argmax()) // 2
    standing = np.repeat(kick[:1], 60, axis=0)
    skeletons = [skeleton_from_handles(decode(values)) for values in (kick[: high + 1], standing)]
    data = tuple(packed_stretch(one.root_translation, one.rotations) for one in skeletons)
    examples = (
        replace(pack.examples[1], frames=high + 1),
        replace(pack.examples[1], name="stand", texts=(), frames=60),
    )
    short = replace(pack, examples=examples, data=data)
    cut = short.features(0)
    assert on_one_leg(cut[-4:]) and not on_one_leg(cut[:4])
    guide = laid(short, Found(0, False, 0.9), 100, units, np.random.default_rng(0))
    laid_out = units.restore(guide.values)
    assert np.abs(laid_out[:, 3:] - cut[-1, 3:]).max(axis=1).min() < 1e-3
    assert (guide.share == 1).all() and not on_one_leg(laid_out[-5:])


def _cut(pack, stop, loop):
    """The pack with the first frames of its wave alone."""
    skeleton = skeleton_from_handles(decode(pack.features(0)[:stop]))
    data = (packed_stretch(skeleton.root_translation, skeleton.rotations), *pack.data[1:])
    return replace(pack, examples=(replace(pack.examples[0], frames=stop, loop=loop), *pack.examples[1:]), data=data)


def test_half_a_movement_is_not_played_on_and_a_whole_one_from_its_first_frame(pack, units):
    wave = pack.features(0)
    away = np.abs(wave[:, 3:] - wave[0, 3:]).sum(axis=1)
    high, back = int(away[:20].argmax()), 20 + int(away[20:].argmin())
    assert goes_on(pack, WAVE) and not goes_on(pack, KICK)
    assert not goes_on(_cut(pack, high + 1, (high, high - 4)), WAVE)
    whole = _cut(pack, back + 1, (high, high - 4))
    assert goes_on(whole, WAVE)
    long = lay(whole, units, WAVE, 3 * back)
    rounds = range(round(0.9 * back), round(1.15 * back))  # its tempo is drawn
    assert min(np.abs(long[:back, 3:] - long[at : at + back, 3:]).max() for at in rounds) < 0.1
    assert np.ptp(long[:, 3:], axis=0).max() > 0.9 * np.ptp(wave[:, 3:], axis=0).max()


def test_standing_on_one_leg_is_nothing_to_be_joined_to(pack, features):
    examples = tuple(replace(one, texts=()) for one in pack.examples)
    kick = pack.features(1)
    assert on_one_leg(kick)
    assert replace(pack, examples=examples).standing == (0,)


def test_a_gesture_made_by_code_is_told_apart_and_joined_to_standing_of_its_kind(pack, units):
    named = [replace(one, name=f"gesture_{one.name}") for one in pack.examples]
    still = pack.features(1)[:1].repeat(60, axis=0)
    skeleton = skeleton_from_handles(decode(still))
    data = (*pack.data, packed_stretch(skeleton.root_translation, skeleton.rotations))
    stands = replace(named[1], name="gesture_standing", texts=(), frames=60)
    made = replace(pack, examples=(*named, stands), data=data, motions=np.tile(np.eye(4)[:3], (2, 1, 1)))
    guide = laid(made, KICK, 100, units, np.random.default_rng(0))
    assert guide.made.all() and not laid(pack, KICK, 100, units, np.random.default_rng(0)).made.any()
    both = laid_script(made, [(None, 20), (KICK, 60)], 80, units, np.random.default_rng(0))
    assert not both.made[:20].any() and both.made[20:].all()
    examples = GuidanceExamples(made, {"kicks": (clause_of("a person kicks with the right leg"), np.eye(4)[1])})
    assert examples.shows(clause_of("kicks")) and examples.led_by([(clause_of("kicks"), 40)])
    captured = GuidanceExamples(pack, {"kicks": (clause_of("a person kicks with the right leg"), np.eye(4)[1])})
    assert captured.led_by([(clause_of("kicks"), 40)])
    assert not examples.shows(clause_of("sings")) and not examples.led_by([(clause_of("sings"), 40)])


def test_a_loop_has_whole_cycles_that_close_and_none_of_what_is_done_once(pack, units):
    values = units.restore(laid(pack, WAVE, 50, units, np.random.default_rng(0), Manner(closed=True)).values)
    assert len(values) == 50
    step = np.abs(np.diff(values[:, 3:], axis=0)).max()
    assert np.abs(values[-1, 3:] - values[0, 3:]).max() < 1.5 * step
    once = laid(pack, KICK, 50, units, np.random.default_rng(0), Manner(closed=True))
    assert not once.share.any() and len(once.values) == 50


def test_a_cycle_is_done_as_often_as_fits_best():
    features = np.zeros((40, 271), np.float32)
    features[:, 5] = np.sin(2 * np.pi * np.arange(40) / 10)  # a cycle of ten frames
    features[:, 2] = 1.0
    found = circled(features, (25, 5), 44)  # two of them span the cycle that was named
    np.testing.assert_allclose(found[:, 5], np.sin(2 * np.pi * (np.arange(44) * 40 / 44 % 20 + 5) / 10), atol=0.06)
    np.testing.assert_allclose(found[:, 2], 40 / 44, atol=1e-5)


def test_a_gesture_made_by_code_that_rests_in_the_air_stays_there(pack, units):
    high = pack.features(1).copy()
    high[:, 3] += np.linspace(0, 1.5, len(high))
    high[-6:] = high[-6]
    high[-6:, :3] = 0
    skeleton = skeleton_from_handles(decode(high))
    data = (pack.data[0], packed_stretch(skeleton.root_translation, skeleton.rotations))
    for name, stays in (("climb", False), ("gesture_ladder_1", True)):
        climb = replace(pack, examples=(pack.examples[0], replace(pack.examples[1], name=name)), data=data)
        guide = laid(climb, KICK, 60, units, np.random.default_rng(0))
        assert (guide.share[-5:] == 1).all() == stays


def test_a_motion_in_a_row_is_done_so_often_without_a_jump(pack, units):
    kick = pack.features(1)
    away = np.linalg.norm(kick[:, 3:] - kick[0, 3:], axis=1).max()

    def swings(features):
        up = np.linalg.norm(features[:, 3:] - kick[0, 3:], axis=1) > 0.5 * away
        return np.count_nonzero(up[1:] & ~up[:-1])

    def fastest(features):
        return np.linalg.norm(np.diff(features[:, 3:], axis=0), axis=1).max()

    three = repeated(kick, 3)
    assert swings(three) == 3 * swings(kick) > 0 and fastest(three) <= fastest(kick) + 1e-5
    assert swings(lay(pack, units, KICK._replace(times=2), 120)) == 2 * swings(kick)


@pytest.fixture(scope="module")
def networks():
    return Networks(None)


def known(networks, prompt):
    """What is found for a prompt, and its clauses."""
    clauses = parse(prompt, force=True).clauses
    texts = Texts.of(networks, [clauses], True, True, None)
    return GuidanceExamples(networks.examples, texts.shown), clauses


def offered(networks, prompt, seed=0):
    """The examples that a prompt starts from, and the counts that they are made with."""
    found, clauses = known(networks, prompt)
    example = found.of([(clause, 120) for clause in clauses], (seed, 0), 0)
    if example is None:
        return [], []
    return [networks.examples.examples[one.number] for one in example.found if one], [
        manner.count for manner in example.manners
    ]


@pytest.mark.parametrize(
    ("prompt", "lacking"),
    [
        ("scratch foot", ("foot",)),
        ("plays the guitar behind the back", ("back",)),
        ("claps above the head", ("head", "high")),
        ("punches twice with the right hand", ("2 times",)),
    ],
)
def test_a_gesture_that_leaves_out_what_is_added_is_not_used_and_it_is_said(networks, prompt, lacking):
    found, clauses = known(networks, prompt)
    assert not any(one.made for seed in range(4) for one in offered(networks, prompt, seed)[0])
    assert found.retrieved(clauses[0]).lacking == lacking


def test_who_stands_already_does_not_get_up(networks):
    for prompt, parts in (
        ("a person bends down to pick up an object, then stands up straight", 1),
        ("a person turns to the right and starts sneakily moving forward", 2),
        ("a person sits down, then stands up", 2),
    ):
        found, clauses = known(networks, prompt)
        kept = found.needed(clauses)
        assert len(kept) == parts
        assert sum(clause.seconds for clause in kept) == pytest.approx(sum(clause.seconds for clause in clauses))
    assert kept[0].count is None


@pytest.mark.parametrize(
    ("prompt", "least", "most"),
    [
        ("Roll", 1.2, 2.2),
        ("Golf Drive", 3.5, 5.5),
        ("pulls a lever down", 2.5, 4.5),
        ("picks a box up from the floor", 3.0, 6.0),
        ("walks", 6.0, 6.0),
        ("hammers a nail", 6.0, 6.0),
        ("walks, then rolls", 6.0, 6.0),
    ],
)
def test_a_clip_without_a_length_is_as_long_as_what_is_done(networks, prompt, least, most):
    found, clauses = known(networks, prompt)
    assert least <= sum(clause.seconds for clause in found.fitted(clauses)) <= most
    asked = parse(prompt, 5.0).clauses
    assert found.fitted(asked) == asked


def test_what_goes_on_is_done_to_the_end_whatever_it_is_done_with(networks):
    """A person who walks up a slope does not stop after two steps."""
    found, clauses = known(networks, "walks up a slope")
    example = found.of([(clauses[0], 120)], (0, 0), 0)
    statistics = FeatureStatistics(np.zeros(271), np.ones(271))
    speed = np.linalg.norm(example.on([120], 120, statistics).values[:, 1:3], axis=1)
    assert speed[-40:].mean() > 0.7 * speed.mean() > 0.2


def test_who_sits_with_crossed_legs_is_no_gesture_of_sitting(networks):
    for seed in range(6):
        for one in offered(networks, "sits while crossing legs", seed)[0]:
            assert one.name.startswith("gesture_cross_legs")


@pytest.mark.parametrize(("seat", "texts"), [("ground", "on the floor"), ("chair", "on a chair")])
def test_legs_are_crossed_where_a_person_sits(networks, seat, texts):
    for seed in range(3):
        for one in offered(networks, f"sits on the {seat} and crosses his legs", seed)[0]:
            assert one.name.startswith("gesture_cross_legs") and texts in one.texts[1]


def test_a_thing_goes_through_its_places_or_is_picked_up_as_captured(networks):
    def of(prompt):
        found, clauses = known(networks, prompt)
        return [one.detail for one in found.retrieved(clauses[0]).found]

    assert [one.steps[-1].place for one in of("puts a box on a shelf to the left")] == [("high", "left")]
    assert of("a person picks up something from the floor")[0] is None


MISREAD = pytest.mark.xfail(strict=True, reason="the reader takes it for something else")


@pytest.mark.parametrize(
    ("prompt", "gesture", "part"),
    [
        ("scratch chin", "gesture_scratch", "chin"),
        ("touches the back of the head", "gesture_touch", "back-head"),
        ("rubs his knee three times", "gesture_rub", "knee"),
        ("scratches the head", "gesture_scratch", ""),
        ("slaps", "gesture_slap", ""),
        ("duck quickly", "gesture_duck", ""),
        pytest.param("push door", "gesture_push", "", marks=MISREAD),
        ("looks up at the sky", "gesture_look_up", ""),
        ("balances on one leg", "gesture_balance", ""),
        ("a person does a sit-up, holding their head with both hands", "gesture_sit-up", ""),
        ("a person does sit-ups", "gesture_sit-up", ""),
        ("tie shoelaces", "gesture_tie_shoes", ""),
    ],
)
def test_a_gesture_is_done_where_the_sentence_says(networks, prompt, gesture, part):
    assert parse(prompt, force=True).corrected == ()
    found, clauses = known(networks, prompt)
    assert found.retrieved(clauses[0]).lacking == ()
    for seed in range(4):
        example = found.of([(clauses[0], 120)], (seed, 0), 0)
        (one,) = example.found
        assert networks.examples.examples[one.number].name.startswith(gesture) and one.part == part


def test_who_points_to_a_side_does_not_point_ahead(networks):
    for seed in range(8):
        (one,) = offered(networks, "points to the left", seed)[0]
        assert "points right" in one.texts  # in the mirror


@pytest.mark.parametrize(
    ("prompt", "gesture", "count"),
    [
        ("knock twice", "gesture_knock", 2),
        ("claps", "gesture_clap", None),
        ("a person claps three times", "gesture_clap", 3),
        ("nods 5 times", "gesture_nod", 5),
        ("the child waves goodbye", "gesture_wave", None),
    ],
)
def test_what_adds_nothing_is_a_gesture_with_its_count(networks, prompt, gesture, count):
    examples, counts = offered(networks, prompt)
    assert [one.name.rpartition("_")[0] for one in examples] == [gesture] and counts == [count]


def test_either_hand_waves_where_none_is_named_and_no_salute_is_with_the_left(networks):
    def hands(prompt):
        found, clauses = known(networks, prompt)
        return {found.of([(clauses[0], 120)], (seed, 0), 0).found[0].mirrored for seed in range(24)}

    assert hands("waves") == {False, True}
    assert hands("waves with the left hand") == {True}
    assert hands("salutes") == {False}


def test_a_look_or_a_leg_is_on_the_side_that_is_said(networks):
    for prompt, gesture, mirrored in (
        ("a person looks right", "gesture_look_aside", False), ("a person looks left", "gesture_look_aside", True),
        ("eats with the right hand", "gesture_eat", False), ("eats with the left hand", "gesture_eat", True),
    ):  # fmt: skip
        found, clauses = known(networks, prompt)
        for seed in range(4):
            (one,) = found.of([(clauses[0], 120)], (seed, 0), 0).found
            assert networks.examples.examples[one.number].name.startswith(gesture) and one.mirrored == mirrored


def test_numbers_that_count_and_those_that_do_not():
    counts = {
        "claps twice": 2, "waves three times": 3, "does two jumping jacks": 2, "nods 4 times": 4, "bows once": 1,
        "waves with two hands": None, "walks with one hand on the hip": None, "claps": None,
    }  # fmt: skip
    assert {text: clause_of(text).count for text in counts} == counts


def test_what_a_clause_adds():
    added = {
        "scratches the chin": ("chin",), "sits while crossing legs": ("sits", "legs"), "claps happily": (),
        "waves at a friend": (), "a person applauds": (), "hugs somebody": (), "flexes both arms": (),
        "waves with the foot": ("foot",), "eats with the left hand": (), "does a spin": (),
        "does sit-ups holding a ball": ("holding",),
    }  # fmt: skip
    assert {text: clause_of(text).added for text in added} == added


def test_what_hands_do_in_an_exercise_is_added():
    assert clause_of("does a sit-up, holding the head with both hands").added == ("head", "hands")


def test_the_name_of_a_gesture_is_the_action_that_its_sentences_say(networks):
    pack = networks.examples
    named = [index for index, action in enumerate(pack.actions) if action]
    assert len(named) == sum(pack.made) - 1  # the gesture of standing has no action
    assert all(pack.said[index].actions == {pack.actions[index]} for index in named)


def test_what_no_motion_shows_is_said(networks):
    def unseen(prompt, **read):
        found, clauses = known(networks, prompt)
        return found.unseen(replace(clauses[0], **read))

    assert unseen("does the macarena", actions=("dance",)) == ("macarena", "dance")
    for prompt in ("dances", "a person limps", "waves", "claps", "runs fast", "plays the guitar", "facepalms"):
        assert unseen(prompt) == ("", "")
