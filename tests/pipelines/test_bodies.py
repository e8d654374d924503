"""Sentences in words for what a body does in their place."""

from __future__ import annotations

import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.reference import reference_body
from bunraku.language.parse import parse
from bunraku.pipelines.bodies import as_bodies_do
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character
from bunraku_lab.synthetic.samples import make_sample


@pytest.fixture(scope="module")
def bodies():
    made = {name: RigParts.of(make_sample(name, rigged=True)) for name in ("dog", "dragon")}
    made["snake"] = RigParts.of(code_made_character("snake", EVALUATION_SEED))
    known = {name: (parts.character, parts.handles) for name, parts in made.items()}
    return known | {"person": (reference_body().character(), reference_body().handles)}


@pytest.mark.parametrize(
    ("body", "clause", "said", "way"),
    [
        ("person", "a person walks", "a person walks", "step"),
        ("person", "climbs a ladder", "a person climbs a ladder", ""),
        ("dog", "a person walks", "it walks forward", "step"),
        ("dog", "a rat walks", "it walks forward", "step"),
        ("dog", "trots", "it trots forward", "run"),
        ("dog", "a dog walks slowly", "it walks slowly forward", "step"),
        ("dog", "runs in a circle", "it runs in a circle", "run"),
        ("dog", "walks to the left", "it walks to the left", "step"),
        ("dog", "a dog runs and jumps", "it runs and jumps", "stay"),
        ("dog", "a dog eats", "a dog eats", "stay"),
        ("dog", "swims", "it walks forward", "step"),
        ("dragon", "a dragon flies away", "a bird flies away", "fly"),
        ("dragon", "flies", "a bird flies", "fly"),
        ("dragon", "runs", "it runs forward", "run"),
        ("snake", "a snake bites", "a snake bites", "lie"),
        ("snake", "a snake crawls", "a snake slithers", "slither"),
    ],
)
def test_a_clause_is_said_and_done_as_the_body_can(bodies, body, clause, said, way):
    (sentence,), as_people = as_bodies_do([parse(clause, 2.0)], Anatomy.of(*bodies[body]))
    assert [(one.text, one.seconds) for one in sentence.clauses] == [(said, 2.0)]
    assert [one.moves for one in sentence.clauses] == [way]
    assert as_people == (body == "person")


def test_clauses_share_the_time_of_their_sentence(bodies):
    (sentence,), _ = as_bodies_do([parse("flies:3; stands:1")], Anatomy.of(*bodies["dragon"]))
    assert [(one.moves, one.seconds / sentence.seconds) for one in sentence.clauses] == [("fly", 0.75), ("stay", 0.25)]
