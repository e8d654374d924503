from dataclasses import replace

import numpy as np

from bunraku.diffusion.examples.retrieve import retrieve

AXES = np.eye(4)


def names(pack, sentence, vector):
    return [(pack.examples[one.place].name, one.mirrored) for one in retrieve(pack, sentence, vector)]


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
