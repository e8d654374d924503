from dataclasses import replace

import numpy as np

from bunraku.diffusion.examples.retrieve import retrieve
from bunraku.language.parse import clause_of

AXES = np.eye(4)


def names(pack, sentence, vector):
    return [(pack.examples[one.number].name, one.mirrored) for one in retrieve(pack, clause_of(sentence), vector).found]


def test_the_nearest_that_does_the_same_is_found(pack):
    assert names(pack, "someone is waving", AXES[0]) == [("wave", False)]
    assert names(pack, "someone kicks", AXES[1]) == [("kick", False)]


def test_another_side_is_the_mirror_image(pack):
    between = (AXES[0] + AXES[2]) / 2**0.5  # as near to the wave as to its mirror image
    assert names(pack, "someone waves with the left hand", between) == [("wave", False)]
    assert names(pack, "someone waves with the right hand", between) == [("wave", True)]


def test_what_does_something_else_is_no_example_however_near(pack):
    assert names(pack, "a person sits down", 0.8 * AXES[0] + 0.6 * AXES[3]) == []
    assert names(pack, "a person walks and waves with the left hand", 0.8 * AXES[0] + 0.6 * AXES[3]) == []


def test_a_sentence_without_a_known_action_takes_only_what_means_the_same(pack):
    assert names(pack, "hello", AXES[0]) == [("wave", False)]
    assert names(pack, "hello", 0.8 * AXES[0] + 0.6 * AXES[1]) == []


def test_what_is_far_is_no_example(pack):
    assert names(pack, "someone is waving", 0.5 * AXES[0] + 0.75**0.5 * AXES[1]) == []


def test_a_pace_that_was_not_asked_for_and_the_floor_in_place_of_a_chair_are_no_example(pack):
    def named(*texts):
        return replace(pack, examples=(replace(pack.examples[0], texts=texts), pack.examples[1]))

    slow = named("a person waves slowly with the left hand", "waves")
    assert names(slow, "someone is waving", AXES[0]) == []
    assert names(slow, "someone is waving slowly", AXES[0]) == [("wave", False)]
    up = named("a person gets up from the floor", "stands up")
    assert names(up, "someone gets up from a chair", AXES[0]) == []
    assert names(up, "someone gets up", AXES[0]) == [("wave", False)]


def test_plain_walks_take_only_what_is_near(pack):
    walk = replace(pack, examples=(replace(pack.examples[0], texts=("a person walks", "walk")), pack.examples[1]))
    for cosine, found in ((0.75, []), (0.85, [("wave", False)])):
        near = cosine * AXES[0] + (1 - cosine**2) ** 0.5 * AXES[1]
        assert names(walk, "somebody walks", near) == found
        assert names(pack, "somebody waves", near) == [("wave", False)]


def test_where_a_gesture_made_by_code_is_nearest_only_what_is_about_as_near_is_offered(pack):
    near = 0.75 * AXES[0] + 0.66 * AXES[1]
    both = replace(pack, examples=(pack.examples[0], replace(pack.examples[1], texts=("waves",))))
    assert names(both, "someone is waving", (AXES[0] + AXES[1]) / 2**0.5) == [("wave", False), ("kick", False)]
    assert len(names(both, "someone is waving", near)) == 2
    made = replace(both, examples=(replace(both.examples[0], name="gesture_wave_1"), both.examples[1]))
    assert names(made, "someone is waving", near) == [("gesture_wave_1", False)]
    assert len(names(made, "someone is waving", (AXES[0] + AXES[1]) / 2**0.5)) == 2
    other = replace(both, examples=(both.examples[0], replace(both.examples[1], name="gesture_wave_1")))
    assert ("wave", False) in names(other, "someone is waving", near)


def test_a_gesture_made_by_code_is_what_its_words_say_however_near(pack):
    sits = replace(pack, examples=(replace(pack.examples[0], texts=("does sit-ups",)), pack.examples[1]))
    assert names(sits, "a person sits down", AXES[0]) == [("wave", False)]  # its sentence means the same
    made = replace(sits, examples=(replace(sits.examples[0], name="gesture_sit-up_1"), pack.examples[1]))
    assert names(made, "a person sits down", AXES[0]) == []
    assert names(made, "someone does sit-ups", AXES[0]) == [("gesture_sit-up_1", False)]


def named(pack, name, *texts):
    return replace(pack, examples=(replace(pack.examples[0], name=name, texts=texts), pack.examples[1]))


def test_a_gesture_made_by_code_is_mirrored_only_where_a_side_is_said(pack):
    between = (AXES[0] + AXES[2]) / 2**0.5
    made = named(pack, "gesture_wave_1", "a person waves with the left hand", "waves")
    assert names(made, "someone is waving", between) == [("gesture_wave_1", False)]
    assert names(made, "someone waves with the right hand", between) == [("gesture_wave_1", True)]


def test_a_halt_that_was_not_asked_for_is_no_example_of_a_run(pack):
    run = named(pack, "run", "someone running comes to a halt and sets off again", "runs")
    assert names(run, "a person runs", AXES[0]) == []
    assert names(named(pack, "run", "a person runs"), "a person runs", AXES[0]) == [("run", False)]


def test_one_arm_is_no_example_of_both(pack):
    one, two = named(pack, "one", "raises the left arm"), named(pack, "two", "raises both arms")
    assert names(one, "a person raises an arm", AXES[0]) == [("one", False)]
    assert names(one, "a person raises both arms", AXES[0]) == []
    assert names(two, "a person raises both arms", AXES[0]) == [("two", False)]
    assert names(two, "a person raises an arm", AXES[0]) == []


def test_who_is_on_the_floor_does_not_get_up_from_a_chair(pack):
    chair = named(pack, "chair", "stands up from a chair")
    assert names(chair, "a person stands up from the floor", AXES[0]) == []
    assert names(chair, "a person stands up", AXES[0]) == [("chair", False)]


def test_both_feet_are_no_example_of_one(pack):
    hop = named(pack, "hop", "hops forward from both feet", "hops")
    assert names(hop, "a person hops on one foot", AXES[0]) == []
    assert names(hop, "a person hops", AXES[0]) == [("hop", False)]


def test_who_sets_off_from_a_walk_is_no_example_of_a_run(pack):
    off = named(pack, "off", "someone walks forward a little and then takes off into a run", "a person runs")
    assert names(off, "a person runs forward", AXES[0]) == []
    off = named(pack, "off", "a person runs, speeding up", "a person runs")
    assert names(off, "a person runs", AXES[0]) == []
    assert names(off, "a person runs, speeding up", AXES[0]) == [("off", False)]


def test_who_climbs_down_or_up_a_ladder_is_no_example_of_climbing_stairs(pack):
    down = named(pack, "down", "a person climbs back down step by step", "climbs")
    assert names(down, "a person climbs", AXES[0]) == []
    assert names(down, "a person climbs down", AXES[0]) == [("down", False)]
    ladder = named(pack, "ladder", "a person climbs a ladder", "climbs")
    assert names(ladder, "a person climbs the stairs", AXES[0]) == []
    assert names(ladder, "a person climbs", AXES[0]) == [("ladder", False)]


def test_what_is_shown_once_is_done_as_often_as_is_counted(pack):
    (one,) = retrieve(pack, clause_of("someone kicks twice with the right leg"), AXES[1]).found
    assert one.number == 1 and one.times == 2
    assert retrieve(pack, clause_of("someone kicks with the right leg"), AXES[1]).found[0].times == 1
    assert names(pack, "someone waves twice with the left hand", AXES[0]) == []  # that goes on, as often as it likes
    assert names(pack, "someone kicks nine times with the right leg", AXES[1]) == []
    twice = replace(pack.examples[1], texts=("a person kicks twice with the right leg",))
    counted = replace(pack, examples=(pack.examples[0], twice))
    (one,) = retrieve(counted, clause_of("someone kicks twice with the right leg"), AXES[1]).found
    assert one.times == 1
    assert names(counted, "someone kicks three times with the right leg", AXES[1]) == []


def test_the_limb_that_is_meant_counts_more_than_the_way_of_its_movement(pack):
    assert names(pack, "someone kicks a ball to the left with the right foot", AXES[1]) == [("kick", False)]
    assert names(pack, "someone kicks a ball to the left with the left foot", AXES[1]) == []
    assert names(pack, "someone kicks a ball to the left", AXES[1]) == []


def test_who_falls_does_not_get_up_where_nobody_says_so(pack):
    again = named(pack, "again", "a person falls, gets up and falls again", "falls")
    assert names(again, "a person falls", AXES[0]) == []
    assert names(again, "a person falls and gets up again", AXES[0]) == [("again", False)]
    assert names(named(pack, "down", "a person falls and lies still", "falls"), "a person falls", AXES[0])


def test_what_is_high_is_no_example_of_what_is_low(pack):
    high = named(pack, "high", "a person kicks high with the left foot")
    assert names(high, "a person does a low kick", AXES[0]) == []
    assert names(high, "a person kicks", AXES[0])


def test_examples_that_show_more_are_left_where_enough_do_not(pack):
    extra = [replace(pack.examples[0], name=f"{n}", texts=(text, "waves")) for n, text in enumerate((
        "a person waves and kicks", "a person waves", "a person is waving", "waves on", "waves and waves",
    ))]  # fmt: skip
    size = len(extra)
    many = replace(
        pack, examples=tuple(extra), data=pack.data[:1] * size, owners=np.arange(size),
        texts=np.repeat(pack.texts[:, :1], size, axis=1), motions=np.repeat(pack.motions[:, :1], size, axis=1),
    )  # fmt: skip
    assert [name for name, _ in names(many, "someone is waving", AXES[0])] == ["1", "2", "3", "4"]
