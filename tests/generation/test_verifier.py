"""Whether a motion is what its sentence says and nothing else, and the choice among candidates."""

from dataclasses import replace

import numpy as np
import pytest
from moving_people import kick, person, ramp

from bunraku.generation.candidates import ATTEMPTS, CAPTURED, Candidate, choose, script_scores
from bunraku.generation.extractor import RADIUS, ExtractorConfig, embed_motions, load_ranker
from bunraku.generation.features import decode, encode, mirror
from bunraku.generation.generate import _APART, generate_motions
from bunraku.generation.verifier import Verdict, verify
from bunraku.language.captions import mirror_words
from bunraku.language.encoders import text_encoder
from bunraku.language.parse import clause_of, clauses_of
from bunraku_lab.nn.text import embed_sentences


def agreement(sentence, motion):
    return verify(clause_of(sentence), motion).agreement


def turning(degrees):
    return person(60, heading=ramp(60, 10, 50, np.radians(degrees)))


def raising(side):
    up = np.zeros((60, 3))
    up[:, 1] = ramp(60, 10, 30, 0.6)
    return person(60, hands={side: up + [0, -0.3, 0]})


MOTIONS = {
    "a person turns left": turning(90),
    "a person turns around": turning(-180),
    "a person makes a full turn to the right": turning(-360),
    "a person walks forward": person(60, speed=1.2, steps=0.3),
    "a person walks backwards": person(60, speed=0.8, course=np.pi, steps=0.2),
    "a person steps to the left": person(60, speed=0.4, course=np.pi / 2, steps=0.1),
    "a person kicks with the right leg": person(44, feet=kick(44, 12, "right")),
    "a person stands on the left leg": person(44, feet=kick(44, 12, "right")),
    "a person raises the left arm": raising("left"),
    "a person throws a ball with the left hand": raising("left"),
    "a person sits down": person(80, height=-ramp(80, 10, 40, 0.4)),
    "a person stands up from the chair": person(80, height=ramp(80, 10, 40, 0.4) - 0.4),
}


@pytest.mark.parametrize("sentence", MOTIONS)
def test_a_true_sentence_agrees_as_its_mirror_image_does(sentence):
    motion = MOTIONS[sentence]
    assert agreement(sentence, motion) > 0.7
    mirrored = decode(mirror(encode(motion)))
    assert agreement(mirror_words(sentence), mirrored) == pytest.approx(agreement(sentence, motion), abs=0.02)


@pytest.mark.parametrize("sentence", [one for one in MOTIONS if mirror_words(one) != one])
def test_the_other_side_does_not(sentence):
    assert agreement(mirror_words(sentence), MOTIONS[sentence]) < -0.5


@pytest.mark.parametrize(
    ("sentence", "motion"),
    [
        ("a person turns left", turning(300)),
        ("a person turns around", turning(60)),
        ("a person walks backwards", MOTIONS["a person walks forward"]),
        ("a person walks forward", person(60)),
        ("a person walks as if very tired", person(60)),
        ("a person runs in a circle", person(60, speed=0.1)),
        ("a person sits down", person(80)),
        ("a person looks to the left", person(80)),
        ("a person walks through deep snow", person(80)),
        ("a person walks while holding a cup in the right hand", person(80)),
    ],
)
def test_what_is_not_done_or_too_much_of_it(sentence, motion):
    assert agreement(sentence, motion) < 0.25


def test_who_walks_goes_somewhere_but_not_in_place():
    assert agreement("a person walks as if very tired", person(60, speed=0.4, steps=0.1)) == 1
    walks = person(60, speed=1.2, steps=0.3)
    assert verify(clause_of("a person walks in place"), walks) == Verdict(-1.0, "staying in place")


def test_who_sits_down_stood_before():
    seated = person(80, height=np.full(80, -0.4))
    assert agreement("a person sits down", seated) < 0.25 < agreement("a person sits on a chair", seated)


@pytest.mark.parametrize(
    ("sentence", "motion", "missed"),
    [
        ("a person kicks", turning(100), "facing one way"),
        ("a person waves", person(80, speed=0.8, steps=0.2), "staying in place"),
        ("a person waves", person(80, height=-ramp(80, 5, 60, 0.4)), "keeping the posture"),
        ("a person throws a ball", person(100, heading=ramp(100, 50, 60, 0.4)), "beginning at once"),
        ("a person throws a ball", person(100, heading=ramp(100, 5, 15, 0.4)), "filling the time"),
    ],
)
def test_nothing_is_done_that_was_not_asked_for(sentence, motion, missed):
    verdict = verify(clause_of(sentence), motion)
    assert verdict.missed == missed and verdict.agreement < 0.2


def test_a_dance_may_turn():
    assert verify(clause_of("a person dances"), turning(180)).missed != "facing one way"


@pytest.mark.parametrize(
    ("sentence", "stands"),
    [
        ("a person sits down", True),
        ("someone takes a seat", True),
        ("a person lies down on the floor", True),
        ("a person sits on a chair", True),
        ("a person is sitting", False),
        ("a person stands up", False),
        ("a person walks", False),
    ],
)
def test_who_goes_down_starts_standing(sentence, stands):
    assert ("goes down" in clause_of(sentence).traits) is stands


@pytest.mark.parametrize(
    ("sentence", "straight"),
    [("walks on", True), ("a person runs straight on", True), ("a person walks forward", True), ("walks", False),
     ("walks on the hands", False), ("walks on in a circle", False), ("turns left and walks on", False)],
)  # fmt: skip
def test_who_goes_on_goes_straight(sentence, straight):
    assert clause_of(sentence).straight is straight


def test_who_walks_does_so_for_most_of_the_time():
    stops = person(80, speed=np.where(np.arange(80) < 40, 1.2, 0.0), steps=0.3)
    assert agreement("a person walks across the room", stops) < 0.5
    assert agreement("a person walks forward", stops) < 0.5
    assert agreement("a person walks forward", person(80, speed=0.6, steps=0.2)) == 1


def test_a_circle_is_turned_evenly():
    even = person(80, speed=1.0, steps=0.3, heading=ramp(80, 0, 80, np.radians(330)))
    odd = person(80, speed=1.0, steps=0.3, heading=ramp(80, 0, 26, np.radians(330)))
    assert agreement("a person walks in a circle", odd) < 0.5 < agreement("a person walks in a circle", even)


@pytest.fixture
def ranker():
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.text import Extractor, running_extractor

    torch.manual_seed(3)
    sizes = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "embedding": 8, "text_size": 8, "pooled_size": 8}
    return running_extractor(Extractor(ExtractorConfig(**sizes, text_encoder="words")))


def test_a_score_is_the_mean_cosine_over_the_parts_by_their_frames(ranker, encoder, features):
    wave, kick = features("left_elbow", frames=40), features("right_knee", frames=20)
    whole = np.concatenate([wave, kick])
    script = [(clause_of("waves"), 40), (clause_of("kicks"), 20)]
    text = embed_sentences(ranker, encoder, ["waves", "kicks"])
    vectors = embed_motions(ranker, [wave, kick])
    cosines = [float(vectors[0] @ text["waves"]) / RADIUS**2, float(vectors[1] @ text["kicks"]) / RADIUS**2]
    (score,) = script_scores(ranker, text, [whole], [script])
    assert score == pytest.approx((40 * cosines[0] + 20 * cosines[1]) / 60, abs=1e-6)
    both = script_scores(ranker, text, [wave, whole], [[(clause_of("waves"), 40)], script])
    assert both == pytest.approx([cosines[0], score], abs=1e-5)  # whatever stands beside it


def drawn(agreement, number):
    verdict = None if agreement is None else Verdict(agreement, "")
    return Candidate(np.full((1, 1), number, np.float32), np.zeros((1, 1, 3)), [(clause_of("a"), 1)], verdict)


def chosen(told, candidates=2):
    """Which candidates of motions are chosen by their (cosine, agreement), and how many were drawn."""
    asked = []

    def draw(rows, positions):
        asked.extend(zip(rows, positions, strict=True))
        return [
            replace(drawn(told[row][position][1], 100 * row + position), origin=(row, position))
            for row, position in zip(rows, positions, strict=True)
        ]

    def score(some):
        return np.array([told[int(one.motion[0, 0]) // 100][int(one.motion[0, 0]) % 100][0] for one in some])

    return [int(one.motion[0, 0]) for one in choose(draw, len(told), candidates, score)], len(asked)


def test_the_best_of_each_motion_is_taken():
    assert chosen([[(0.1, None), (0.3, None)], [(0.9, None), (0.5, None)]]) == ([1, 100], 4)


def test_what_a_sentence_plainly_says_weighs_more_than_the_ranker():
    assert chosen([[(0.5, -1.0), (0.3, 0.9)]]) == ([1], 2)


def test_more_are_drawn_of_the_motion_that_none_agrees_for():
    """The second motion's first two have the wrong side; the third is right, and the fourth is liked less."""
    wrong = [(0.9, -1.0), (0.8, -1.0), (0.4, 1.0), (0.3, 1.0)]
    assert chosen([[(0.2, 1.0), (0.1, 1.0)], wrong]) == ([0, 102], 6)


def test_after_the_last_attempt_the_least_wrong_is_taken():
    never = [(0.1, -1.0) for _ in range(2 * ATTEMPTS - 1)] + [(0.1, 0.0)]
    assert chosen([never]) == ([2 * ATTEMPTS - 1], 2 * ATTEMPTS)


def test_what_is_chosen_is_the_candidate_with_the_best_score():
    script = [clauses_of([("a person bows", 2.0)])]
    drawn = [generate_motions(script, seeds=[(5, index * _APART)], steps=4)[0] for index in range(3)]
    scores = script_scores(
        load_ranker(),
        embed_sentences(load_ranker(), text_encoder(load_ranker().config.text_encoder), [script[0][0].text]),
        [encode(motion) for motion in drawn],
        [[(script[0][0], 40)]] * 3,
    )
    (chosen,) = generate_motions(script, seeds=[5], steps=4, candidates=3, examples=False)
    apart = [float(np.abs(chosen.rotations - motion.rotations).max()) for motion in drawn]
    assert int(np.argmin(apart)) == int(np.argmax(scores)) and min(apart) < 1e-3


def test_a_candidate_that_starts_from_an_example_is_worth_a_little_more():
    def choice(cosines):
        some = [replace(drawn(None, index), captured=index == 1) for index in range(2)]
        (one,) = choose(lambda rows, positions: some, 1, 2, lambda _: np.array(cosines))
        return int(one.motion[0, 0])

    assert choice([0.5, 0.5 - 0.9 * CAPTURED]) == 1 and choice([0.5, 0.5 - 1.1 * CAPTURED]) == 0


def test_candidates_but_the_first_start_from_examples():
    script = [clauses_of([("a person waves with the right hand", 3.0)])]
    plain, led = (generate_motions(script, seeds=[5], steps=4, candidates=3, examples=way)[0] for way in (False, True))
    assert np.abs(plain.rotations - led.rotations).max() > 0.1
    alone = [generate_motions(script, seeds=[5], steps=4, examples=way)[0] for way in (False, True)]
    np.testing.assert_array_equal(alone[0].rotations, alone[1].rotations)  # one candidate starts from noise
