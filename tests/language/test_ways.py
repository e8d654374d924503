"""Ways of moving that a clause says."""

from __future__ import annotations

import pytest

from bunraku.language.bodies import for_body
from bunraku.language.clauses import subject_of
from bunraku.language.lexicon.reading import said_otherwise
from bunraku.language.parse import clause_of, parse


@pytest.mark.parametrize(
    ("clause", "way"),
    [
        ("a bird flies away", "fly"),
        ("it is hovering", "fly"),
        ("a fish swims around", "swim"),
        ("slithers to the left", "slither"),
        ("a spider is crawling", "crawl"),
        ("walks forward", "walk"),
        ("a dog runs, flying over the grass", "run"),
        ("jumps", ""),
        ("waves", ""),
    ],
)
def test_the_first_verb_of_moving_counts(clause, way):
    assert clause_of(clause).locomotion == way


@pytest.mark.parametrize(
    ("clause", "verb", "said"),
    [
        ("a dog crawls ahead", "walks", "a dog walks ahead"),
        ("runs", "slithers fast", "slithers fast"),
        ("a snake is walking to the left", "slithers", "a snake slithers to the left"),
        ("waves", "walks", "waves"),
    ],
)
def test_verbs_are_replaced_where_they_stand(clause, verb, said):
    subject, predicate = subject_of(clause)
    assert " ".join([subject, said_otherwise(predicate, verb)]).strip() == said


@pytest.mark.parametrize(
    ("clause", "way"),
    [
        ("walks forward", "step"),
        ("a spider is crawling", "step"),
        ("a horse gallops", "run"),
        ("runs and jumps", "stay"),
        ("attacks", "stay"),
        ("stands still", "stay"),
        ("a hair flies", ""),
        ("climbs a ladder", ""),
        ("walks up the stairs", ""),
        ("does a handstand", ""),
        ("skips", "stay"),
        ("sits down on a chair", ""),
    ],
)
def test_how_long_somebody_is_in_the_air_is_told_by_what_is_said(clause, way):
    (done,) = for_body(parse(clause, force=True), "person").clauses
    assert done.moves == way
