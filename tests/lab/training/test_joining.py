import re

import numpy as np

from bunraku_lab.training.rows.joining import link


def order(sentence, words):
    """The words of a sentence in the order in which they happen: what comes "after" comes first."""
    positions = sorted((re.search(word, sentence).start(), word) for word in words)
    found = [word for _, word in positions]
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
