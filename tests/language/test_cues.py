"""Sides, directions, turns and counts of a sentence."""

import numpy as np
import pytest

from bunraku.language.captions.phrases import mirror_words
from bunraku.language.encoders import CuedEncoder
from bunraku.language.lexicon.cues import CUES, said_cues, sentence_cues


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("a person punches with the left hand", {"left arm"}),
        ("a person throws a right hook", {"right arm"}),
        ("someone waves with their left", {"left arm"}),
        ("a person kicks high with the right leg", {"right leg", "high"}),
        ("a person kicks with the left", {"left leg"}),
        ("a person turns to the left", {"left turn"}),
        ("a person makes a half turn to the right", {"right turn", "half"}),
        ("a person steps to the right twice", {"right go", "twice"}),
        ("a person walks slowly backwards", {"backwards", "slow"}),
        ("a person walks counterclockwise in a circle", {"left turn", "full"}),
        ("a person raises the left arm, then kicks with the right foot", {"left arm", "right leg", "then"}),
        ("a person raises both arms", {"both arms"}),
        ("a person stands up", {"gets up"}),
        ("a person claps", set()),
    ],
)
def test_what_is_said(sentence, expected):
    assert said_cues(sentence) == expected


def test_a_mirrored_sentence_has_mirrored_cues():
    """Over the sentences of all rules above and some long ones."""
    swapped = [
        CUES.index(cue.translate(str.maketrans({})).replace("left", "#").replace("right", "left").replace("#", "right"))
        for cue in CUES
    ]
    for sentence in (
        "a person steps left, turns right around once and punches with the left fist",
        "clockwise circles, then a left roundhouse kick", "he leans to his right and reaches up with the left hand",
    ):  # fmt: skip
        np.testing.assert_array_equal(sentence_cues(mirror_words(sentence)), sentence_cues(sentence)[swapped])


def test_cues_stand_behind_the_vector_of_another_encoder(encoder):
    sentences = ["a person turns left twice", "a person waves"]
    plain, cued = encoder.encode(sentences), CuedEncoder(encoder).encode(sentences)
    assert np.array_equal(cued.tokens, plain.tokens) and np.array_equal(cued.pooled[:, :8], plain.pooled)
    said = cued.pooled[:, 8:] * 8**0.5
    assert said.shape[1] == len(CUES) and not said[1].any()
    assert [CUES[index] for index in np.flatnonzero(said[0])] == ["left turn", "twice"]
