"""Clauses: one after another, and at the same time."""

import numpy as np
import pytest

from bunraku.core.body.layout import HANDLE_NAMES, PARTS
from bunraku.core.body.reference import reference_body
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.generation.composition import PartTrack
from bunraku.generation.generate import generate_motions
from bunraku.language.clauses import ENDING, fitting, of_creature, of_person, split_clauses, timed_clauses
from bunraku.language.parse import clause_of, clauses_of


@pytest.mark.parametrize(
    ("sentence", "clauses"),
    [
        ("walks forward, then waves with the left hand", ["walks forward", "waves with the left hand"]),
        ("a person walks and then sits down", ["a person walks", "a person sits down"]),
        ("turns left twice then runs", ["turns left twice", "runs"]),
        ("A horse gallops, then slowly eats", ["A horse gallops", "A horse slowly eats"]),
        ("He walks. Then he jumps.", ["He walks", "he jumps"]),
        ("a man walks, turns around and finally waves", ["a man walks", "a man turns around", "a man waves"]),
        ("first the old woman bows, then she dances", ["the old woman bows", "she dances"]),
        ("a person starts by walking, then is jumping", ["a person walking", "a person is jumping"]),
        ("after bowing, she walks and then sits", ["bowing", "she walks", "she sits"]),
        ("after jumping twice, a person waves", ["jumping twice", "a person waves"]),
        ("a person waves after jumping twice", ["jumping twice", "a person waves"]),
        ("a person stands still before running away", ["a person stands still", "a person is running away"]),
        ("she walks before she sits down", ["she walks", "she sits down"]),
        ("a kick followed by a jump", ["a kick", "a jump"]),
        ("walk, then jump, then wave", ["walk", "jump", "wave"]),
        ("steps forward, watching the ground, and then backs up", ["steps forward, watching the ground", "backs up"]),
        ("walks, jumps, waves", ["walks", "jumps", "waves"]),
        ("a dragon flies up, roars and lands", ["a dragon flies up", "a dragon roars", "a dragon lands"]),
        ("Walk to the left, turn around, walk back", ["Walk to the left", "turn around", "walk back"]),
        ("she walks slowly, then faster, and finally runs", ["she walks slowly, then faster", "she runs"]),
        ('"walks", then "runs"', ["walks", "runs"]),
        ("turns around and looks into the distance", ["turns around", "looks into the distance"]),
        ("a person turns left and waves", ["a person turns left", "a person waves"]),
        ("she stands up and claps", ["she stands up", "she claps"]),
        ("walks forward and salutes", ["walks forward", "salutes"]),
        ("runs and jumps over a fence", ["runs", "jumps over a fence"]),
    ],
)
def test_clauses_come_in_the_order_of_time(sentence, clauses):
    assert split_clauses(sentence) == clauses


@pytest.mark.parametrize(
    "sentence",
    [
        "walks and waves",
        "a man walks and shrugs",
        "jumps and turns",
        "turns and kicks",
        "turns around and walks back",
        "sits down and reads a book",
        "walks forward while nodding and salutes",
        "walks slowly, carefully",
        "walks forward, waving",
        "a man strides along, lifting the legs high, with swinging arms",
        "a person jumps now and then",
        "a person runs, stops and runs again",  # a caption of training
        "walking backwards, then turning around",
        "dances with quick steps, turns and jumps",
        "every now and then he kicks the ball",
        "bows before the king",
        "runs after a thief",
        "walks next to a wall",
        "stands and moves the arms and legs one after the other",
        "leaps up and twists the body before landing",
        "staggers back after being hit",
        "runs left, then right around an obstacle",
        "steps forward and then back again",
        "falls after a deadly hit and lies still",
        "then",
        "",
    ],
)
def test_what_says_no_order_stays_whole(sentence):
    assert split_clauses(sentence) == [sentence]


def test_an_end_without_a_clause_is_left_out():
    assert split_clauses("walks, then") == ["walks, then"]
    assert split_clauses("walks, then jumps, then") == ["walks", "jumps"]


def test_clauses_share_the_time_and_short_ones_stay_together():
    assert timed_clauses("walks, then waves", 5.0) == [("walks", 2.5), ("waves", 2.5)]
    assert timed_clauses("walks, then waves", 1.5) == [("walks, then waves", 1.5)]
    story = timed_clauses("walks, then jumps, then waves, then kicks, then bows", 3.0)
    assert [text for text, _ in story] == ["walks, then jumps", "waves", "kicks, then bows"]
    assert [time for _, time in story] == [1.0, 1.0, 1.0]


def test_what_is_done_once_gets_its_time_and_what_goes_on_the_rest():
    assert timed_clauses("walks, then jumps", 6.0) == [("walks", 4.0), ("jumps", 2.0)]
    assert timed_clauses("idles, then kicks, then walks", 6.0) == [("idles", 1.5), ("kicks", 2.0), ("walks", 2.5)]
    assert timed_clauses("walks, then turns left, then waves", 9.0) == [
        ("walks", 3.5),
        ("turns left", 2.0),
        ("waves", 3.5),
    ]
    jumps = timed_clauses("jumps, then bows", 9.0)
    assert sum(time for _, time in jumps) == pytest.approx(9.0) and jumps[0][1] / jumps[1][1] == pytest.approx(0.8)
    hurried = timed_clauses("walks, then jumps", 3.0)
    assert sum(time for _, time in hurried) == pytest.approx(3.0) and min(time for _, time in hurried) >= 1


def test_clauses_without_a_length_last_as_long_as_people_take_for_them():
    jump, jumps, claps = map(fitting, (["jumps"], ["jumps three times"], ["claps ten times"]))
    assert 1.5 < jump < 3 and jumps > 2.5 * (jump - ENDING) and 8 < claps < 14
    assert fitting(["walks"]) == fitting(["a person stands idle"]) == 6.0
    assert timed_clauses("walks, then jumps", None) == [("walks", 4.0), ("jumps", 2.0)]
    assert fitting(["jumps", "kicks", "bows"]) > 6 and fitting(["jumps 99 times"] * 9) == 120


@pytest.mark.parametrize(
    ("clause", "expected"),
    [
        ("a person walks", "it walks"),
        ("someone is walking slowly", "it is walking slowly"),
        ("walks forward", "it walks forward"),
        ("jumping", "it is jumping"),
        ("a dog runs", "a dog runs"),
        ("walk", "walk"),
    ],
)
def test_what_a_person_does_said_of_a_creature(clause, expected):
    assert of_creature(clause) == expected


def test_who_does_it_is_a_person_unless_that_says_how():
    assert of_person("a guard marches up and down") == "a person marches up and down"
    assert of_person("the old woman sits down") == "a person sits down"
    assert of_person("a drunk man walks home") == "a drunk man walks home"
    assert of_person("the zombie walks") == "the zombie walks"
    assert of_person("waves") == "waves"


ARMS = np.isin(np.arange(30), PARTS["arms"])


@pytest.mark.parametrize(
    ("sentence", "body", "gesture", "part"),
    [
        (
            "a person walks while waving with the left hand",
            "a person walks",
            "a person is waving with the left hand",
            "arms",
        ),
        ("a person walks and waves", "a person walks", "a person waves", "arms"),
        ("she waves while she walks backward", "she walks backward", "she waves", "arms"),
        ("run and clap", "run", "clap", "arms"),
        ("a man is slowly walking while he nods", "a man is slowly walking", "he nods", "head"),
        ("walks forward and shakes the head", "walks forward", "shakes the head", "head"),
        ("walks forward, waving", "walks forward", "waving", "arms"),
        ("the robot marches, and waves", "the robot marches", "the robot waves", "arms"),
        ("a man walks with the hands on his hips", "a man walks", "the hands on his hips", "arms"),
        ("a man lunges, hands on hips", "a man lunges", "hands on hips", "arms"),
        ("a man performs a lunge, hands on hips", "a man performs a lunge", "hands on hips", "arms"),
        ("walks, while raising the right arm", "walks", "raising the right arm", "right arm"),
    ],
)
def test_legs_and_gestures_are_told_apart(sentence, body, gesture, part):
    found = clause_of(sentence)
    assert [voice.text for voice in found.voices] == [body, gesture]
    assert np.flatnonzero(PartTrack.of(0, [found]).handles).tolist() == sorted(
        handle for name in part.split(" and ") for handle in PARTS[name]
    )


@pytest.mark.parametrize(
    ("sentence", "body", "gesture"),
    [
        ("walks while talking on the phone", "walks", "talking on the phone"),
        ("a person sits and reads a book", "a person sits", "a person reads a book"),
        ("a man walks and shrugs", "a man walks", "a man shrugs"),
    ],
)
def test_gestures_move_arms_and_head(sentence, body, gesture):
    found = clause_of(sentence)
    assert [voice.text for voice in found.voices] == [body, gesture]
    assert np.flatnonzero(PartTrack.of(0, [found]).handles).tolist() == sorted({*PARTS["arms"], *PARTS["head"]})


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks", "waves", "walks and turns left", "a person walks with swinging arms", "claps and waves",
        "kicks while waving",
        "walks and stumbles", "walks while climbing a ladder",
        "lifts a box and walks", "walks and waves and claps", "shakes a rug and walks", "and", "walks while", "",
    ],
)  # fmt: skip
def test_other_sentences_have_one_voice(sentence):
    found = clause_of(sentence)
    assert found.voices == () and found.body.text == sentence and found.meanwhile is None


def test_a_twin_owns_its_handles_and_nothing_else():
    twin = PartTrack.of(2, [clause_of("walks"), clause_of("walks and waves")])
    assert (
        twin is not None
        and (twin.motion, twin.sentences) == (2, ("walks", "waves"))
        and np.array_equal(twin.handles, ARMS)
    )
    assert PartTrack.of(0, [clause_of("walks")]) is None
    features = twin.follow(np.zeros((3, 271)), np.ones((3, 271)))
    assert features.sum(1).tolist() == [9.0 * ARMS.sum()] * 3 and features[:, :10].sum() == 0
    assert (twin.adapt(np.zeros((3, 30, 3)), np.ones((3, 30, 3)))[:, :, 0] > 0).tolist() == [ARMS.tolist()] * 3


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_the_legs_walk_on_while_the_hand_waves():
    walk = generate_motions([clauses_of([("a person walks forward", 3.0)])], seeds=4)[0]
    other, both = generate_motions(
        [
            clauses_of([one])
            for one in (("a person jumps", 3.0), ("a person walks forward while waving with the right hand", 3.0))
        ],
        seeds=[1, 4],
    )
    rest = [index for index in range(30) if not ARMS[index]]
    assert np.allclose(both.root_translation, walk.root_translation, atol=1e-3)
    assert np.allclose(both.rotations[:, rest], walk.rotations[:, rest], atol=1e-2)
    positions = reference_body().handles.positions
    posed = both.transforms(positions)
    joints = np.einsum("nkab,kb->nka", posed[..., :3], positions) + posed[..., 3]
    wrist, shoulder = (joints[:, HANDLE_NAMES.index(name), 1] for name in ("right_wrist", "right_shoulder"))
    assert (wrist > shoulder - 0.1).mean() > 0.8
    assert np.allclose(
        other.rotations, generate_motions([clauses_of([("a person jumps", 3.0)])], seeds=1)[0].rotations, atol=1e-2
    )


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_a_loop_of_two_voices_closes():
    (loop,) = generate_motions([clauses_of([("walks while waving with the left hand", 2.0)])], seeds=3, loop=True)
    assert np.array_equal(loop.rotations[0], loop.rotations[-1]) and np.array_equal(
        loop.translations[0], loop.translations[-1]
    )
    assert np.linalg.norm(loop.root_translation[-1] - loop.root_translation[0]) > 1.0
