from __future__ import annotations

import pytest

from bunraku.language.clauses import subject_of
from bunraku.language.parse import clause_of, parse
from bunraku.language.posing import posing_of


def read(sentence):
    return posing_of(subject_of(sentence)[1])


def plain(targets):
    return {(one.side, one.limb, *sorted(one.ways), one.at) for one in targets}


@pytest.mark.parametrize(
    ("sentence", "stance", "held"),
    [
        ("a person stands with crossed legs", "stand", {("both", "leg", "crossed", "")}),
        (
            "a man sits on a chair with one hand on the hip and the other arm up",
            "chair",
            {("one", "arm", "hip"), ("left", "arm", "up", "")},
        ),
        (
            "stands on the left leg, the arms out to the sides",
            "stand",
            {("right", "leg", "lifted", ""), ("both", "arm", "side", "")},
        ),
        ("lies on the belly with the head raised", "belly", {("both", "head", "up", "")}),
        ("sits on the floor leaning back on the hands", "floor", {("both", "trunk", "back", "arm")}),
        ("kneels with the left hand on the right shoulder", "kneel", {("left", "arm", "shoulder")}),
    ],
)
def test_a_stance_and_limbs_that_are_held(sentence, stance, held):
    found = read(sentence)
    assert found.stance.name == stance and plain(found.held) == held and not found.steps and not found.rest


@pytest.mark.parametrize(
    ("sentence", "steps"),
    [
        ("lifts the left knee to hip height", [{("left", "knee", "hip")}]),
        ("raises the left knee and the right arm", [{("left", "knee", "up", "")}, {("right", "arm", "up", "")}]),
        ("leans to the left, then to the right", [{("both", "trunk", "left", "")}, {("both", "trunk", "right", "")}]),
        ("bends the knees and lifts an arm", [{("both", "knee", "bent", "")}, {("one", "arm", "up", "")}]),
        ("tilts the head back", [{("both", "head", "back", "")}]),
    ],
)  # fmt: skip
def test_limbs_that_move_one_after_the_other(sentence, steps):
    found = read(sentence)
    assert [plain(step.targets) for step in found.steps] == steps and not found.held


def test_once_again_and_held():
    assert read("lifts the right leg to the side and holds it").steps[0].stays
    (swing,) = read("swings the right leg back and forth").steps
    assert swing.again and swing.targets[0].ways == {"ahead"} and swing.targets[0].to == {"back"}
    assert read("raises the arms again and again").steps[0].again
    assert read("lifts the knees in turn").steps[0].alternately
    assert not read("raises the arms").steps[0].again


def test_amounts():
    def far(word):
        return read(f"leans {word} to the left").steps[0].targets[0].amount

    assert far("slightly") < far("now") == 1 < far("far")


@pytest.mark.parametrize(
    ("sentence", "rest", "parts"),
    [
        ("a person walks with the hands behind the back", "walks", ("arms",)),
        ("walks slowly forward with the head tilted back", "walks slowly forward", ("head",)),
        ("jogs while stretching the left arm out to the side", "jogs", ("left arm",)),
        ("walks leaning to the right", "walks", ("upper body",)),
        ("dances with the upper body only", "dances", ("lower body",)),
    ],
)
def test_what_goes_on_meanwhile(sentence, rest, parts):
    found = read(sentence)
    assert found.rest == rest and found.parts == parts
    clause = clause_of(sentence)
    assert clause.body.text.endswith(rest) and clause.limbs_meanwhile.parts == parts


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks", "kicks high with the left foot", "throws a ball with both hands over the head",
        "raises the left arm in greeting", "two squats with arms bent", "walks with swinging arms",
        "holds a box over the head", "walks lifting the knees", "bends down and walks forward", "turns to the left",
        "stands up with the hands on the knees", "moves forward", "scratches the head", "waves with the left hand", "",
    ],
)  # fmt: skip
def test_other_sentences_tell_no_limbs(sentence):
    assert read(sentence) is None


def test_the_mirror_image_of_what_is_said():
    for sentence in ("raises the left arm", "leans to the left with the right hand on the left knee"):
        other = sentence.replace("left", "#").replace("right", "left").replace("#", "right")
        assert read(sentence).mirrored.bare == read(other).bare != read(sentence).bare


def test_limbs_one_after_the_other_are_one_clause():
    (clause,) = parse("a person kneels down, then raises both arms, then lowers them").clauses
    assert clause.detail.stance.goes and len(clause.detail.steps) == 2


def test_the_other_limb():
    (one,) = read("stands on the left leg and stretches the other leg forward").steps
    assert plain(one.targets) == {("right", "leg", "ahead", "")}
    held = read("holds the right arm up and the other arm out to the side").held
    assert plain(held) == {("right", "arm", "up", ""), ("left", "arm", "side", "")}


def test_a_limb_that_is_the_subject():
    clause = clause_of("one leg swings back and forth")
    assert clause.detail.steps[0].again and clause.detail.targets[0].limb == "leg"


def test_the_other_hand_is_free():
    clause = clause_of("waves with the right hand while holding the left hand on the hip")
    assert clause.limbs_meanwhile.parts == ("left arm",) and clause.body.actions == ("wave",)
    assert read("waves with the left hand while holding the left hand on the hip") is None


def test_who_is_down_stays_down():
    sat, waves, raises = parse(
        "sits down on a chair, waves with the left hand, then walks away with crossed arms"
    ).clauses
    assert sat.stance is None and waves.stance.name == "seat" and raises.stance is None
    assert raises.limbs_meanwhile.stance is None
    *_, last = parse("kneels down, claps, then raises both arms").clauses
    assert last.detail.stance.name == "kneel" and not last.detail.stance.goes


def test_hands_that_take_a_limb():
    (pulls,) = read("pulls the left knee up to the chest with both hands").steps
    assert ("both", "arm", "knee") in plain(pulls.targets) and pulls.targets[0].limb == "knee"
    (lifts,) = read("lifts the right foot backwards and holds it with the right hand").steps
    assert lifts.stays and plain(lifts.targets) == {("right", "leg", "buttocks"), ("right", "arm", "leg")}


def test_comparisons_say_nothing_of_limbs():
    found = read("runs with the arms spread like wings")
    assert found.rest == "runs" and plain(found.held) == {("both", "arm", "side", "")}
    assert read("walks like a zombie with the arms stretched out in front").rest == "walks like a zombie"


def test_the_other_without_its_limb():
    held = read("walks with one hand on the head and the other on the hip").held
    assert plain(held) == {("one", "arm", "head"), ("left", "arm", "hip")}


def test_a_manner_is_limbs_in_one_word():
    sad = read("walks sadly")
    assert sad.rest == "walks sadly" and {one.limb for one in sad.held} == {"head", "trunk"}
    assert {one.limb for one in read("jogs happily with the hands on the hips").held} == {"head", "trunk", "arm"}
    assert read("claps happily") is None and read("sneaks cautiously") is None


def test_stances_and_limbs_that_are_said_shortly():
    assert read("swings the arms up and down while squatting").stance.name == "squat"
    one, other = read("raises one knee, then the other").steps
    assert plain(one.targets) == {("one", "knee", "up", "")} and plain(other.targets) == {("left", "knee", "up", "")}
    assert plain(read("sits on the floor with the arms around the knees").held) == {("both", "arm", "knee")}
    assert read("steps forward with the right foot and raises both arms").rest == "steps forward with the right foot"
    assert plain(read("stands with the arms and the legs spread").held) == {
        ("both", "arm", "side", ""), ("both", "leg", "apart", ""),
    }  # fmt: skip
