"""What is said in one sentence and done one after the other, told of the past, by participles, or not done at all."""

import pytest

from bunraku.language.clauses import as_present, as_told, parts_of
from bunraku.language.parse import parse


@pytest.mark.parametrize(
    ("sentence", "parts"),
    [
        ("a boy throws a ball and stretches", ["a boy throws a ball", "a boy stretches"]),
        ("a boy throwing a ball and stretching out", ["a boy is throwing a ball", "a boy is stretching out"]),
        ("a man steps forward and does a handstand", ["a man steps forward", "a man does a handstand"]),
        ("a man walked ahead and bowed deeply", ["a man walks ahead", "a man bows deeply"]),
        ("a man drinks while reading", []),
        ("a man walks left and right", []),
        ("a man kicks and kicks again", []),
        ("a man walks, looking down", []),
    ],
)
def test_what_nobody_does_at_once_has_parts(sentence, parts):
    assert parts_of(sentence) == parts


def test_parts_share_the_time_of_their_clause_however_long_it_is():
    (clause,) = parse("a person throws a ball and stretches", 6).clauses
    assert sum(part.seconds for part in clause.parts) == pytest.approx(6)
    assert sum(part.seconds for part in clause.lasting(3).parts) == pytest.approx(3)
    assert not parse("a person throws a ball and stretches", 1.5).clauses[0].parts


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("an old guard in a long coat, walking and looking around", "a person is walking and looking around"),
        ("a person walking forward picks a ball up", "a person is walking forward and picks a ball up"),
        ("a person walks forward, looking down", "a person walks forward, looking down"),
        ("a person is doing jumping jacks", "a person is doing jumping jacks"),
    ],
)
def test_participles_tell_what_is_done(sentence, told):
    assert as_told(sentence) == told


def test_the_past_is_told_as_captions_tell_it():
    assert as_present("the man walked forward") == "the man walks forward"
    assert as_present("a person holds a raised arm") == "a person holds a raised arm"
    texts = [clause.text for clause in parse("the man walked forward, spun around and walked away").clauses]
    assert texts == ["the man walks forward", "the man spins around", "the man walks away"]


@pytest.mark.parametrize(
    ("sentence", "read"),
    [
        ("a person is pushed but did not fall", "a person is pushed"),
        ("a person squats, not standing up", "a person squats"),
        ("a person walks but does not wave and sits down", "a person walks and sits down"),
    ],
)
def test_what_is_not_done_is_not_read(sentence, read):
    found = parse(sentence)
    assert found.english == read and any("is not done" in note for note in found.notes)


def test_arms_do_what_the_verb_says_and_not_whose_they_are():
    assert parse("a chef cuts vegetables").clauses[0].actions == ("cut food",)
    assert parse("a drunk man walks").clauses[0].actions == ("stagger",)
