import re

import numpy as np

from bunraku.diffusion.features import feature_weights
from bunraku.training.diffusion.joining import join_point, link, splice


def test_join_point_and_splice_of_a_wave_leave_no_jump(features):
    wave = features("left_elbow", frames=60, period=20)
    i, j, distance = join_point(wave, wave, feature_weights())
    joined = splice(wave, wave, i, j)
    assert distance < 1e-3 and len(joined) == i + len(wave) - j
    inside = np.abs(np.diff(wave, axis=0)).max()
    assert np.abs(np.diff(joined, axis=0)).max() < 1.05 * inside
    np.testing.assert_array_equal(joined[:i], wave[:i])
    np.testing.assert_array_equal(joined[-20:], wave[-20:])


def order(sentence, words):
    """The words of a sentence in the order in which they happen: what comes "after" comes first."""
    places = sorted((re.search(word, sentence).start(), word) for word in words)
    found = [word for _, word in places]
    late = re.search(r"\w+ (?:\w+ )*?after (?!that)", sentence)
    return found[::-1] if late and not sentence.startswith("after") else found


def test_sentences_of_two_and_three_parts_keep_their_order():
    random = np.random.default_rng(0)
    for phrases, words in (
        (("{walk} ahead", "{wave}"), ["walk", "wav"]),
        (("{sit} down", "{stand} up", "{run} away"), ["sit", "stand", "run"]),
    ):
        made = {link(phrases, random) for _ in range(400)}
        assert len(made) > 40
        for sentence in made:
            assert "{" not in sentence and sentence == " ".join(sentence.split())
            assert order(sentence, words) == words, sentence
        for word in ("then", "before", "after", "first"):
            assert any(word in sentence for sentence in made)


def test_subjects_and_statives():
    random = np.random.default_rng(1)
    made = {link(("{be} tired", "{fall} asleep"), random, ("a horse",)) for _ in range(200)}
    assert not any("being" in sentence or "person" in sentence for sentence in made)
    assert "a horse is tired and then falls asleep" in made
