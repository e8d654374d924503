"""Facts of bodies that pipelines ask for."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import BodyPlan
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import MeshMotion
from bunraku.language.parse import for_body, parse
from bunraku.pipelines.apply import adapt_sentence, adapt_to_body, body_facts, body_kind
from bunraku.pipelines.to_reference import _standing
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
    (sentence,), as_people = adapt_to_body([parse(clause, 2.0)], Anatomy.of(*bodies[body]))
    assert [(one.text, one.seconds) for one in sentence.clauses] == [(said, 2.0)]
    assert [one.moves for one in sentence.clauses] == [way]
    assert as_people == (body == "person")


def test_clauses_share_the_time_of_their_sentence(bodies):
    (sentence,), _ = adapt_to_body([parse("flies:3; stands:1")], Anatomy.of(*bodies["dragon"]))
    assert [(one.moves, one.seconds / sentence.seconds) for one in sentence.clauses] == [("fly", 0.75), ("stay", 0.25)]


PERSON = BodyPlan(hind=2, front=0, upright=True, arms=True, wings=False, tail=False)
DOG = BodyPlan(hind=2, front=2, upright=False, arms=True, wings=False, tail=True)
FISH = BodyPlan(hind=0, front=0, upright=False, arms=False, wings=False, tail=True)
SNAKE = BodyPlan(hind=0, front=0, upright=False, arms=False, wings=False, tail=True, long=True)
BEE = BodyPlan(hind=0, front=0, upright=False, arms=False, wings=True, tail=False)
MERMAID = BodyPlan(hind=0, front=0, upright=True, arms=True, wings=False, tail=True)
SPIDER = BodyPlan(hind=4, front=0, upright=False, arms=False, wings=False, tail=True, further=4)
RAY = BodyPlan(hind=0, front=0, upright=False, arms=True, wings=False, tail=True, long=True)
BIRD = BodyPlan(hind=2, front=0, upright=False, arms=False, wings=True, tail=True)


def test_a_dog_s_parts_are_named_with_how_clear_they_are():
    dog = make_sample("dog", rigged=True)
    facts = body_facts(Anatomy.of(dog, RigParts.of(dog).handles))
    names = {part.name for part in facts.parts}
    assert {"left foreleg", "right foreleg", "left leg", "right leg", "tail", "head", "trunk"} <= names
    assert sum(part.area for part in facts.parts) == pytest.approx(1, abs=0.02)
    assert all(0.5 < part.sure <= 1 for part in facts.parts)
    assert facts.lines[0] == "a body on four legs, with a tail"


def test_a_person_s_arms_are_arms():
    body = reference_body()
    facts = body_facts(Anatomy.of(body.character(), body.handles))
    assert facts.plan.kind == "person" and {"left arm", "right arm"} <= {part.name for part in facts.parts}
    assert facts.cannot == ("no wings are found: where a sentence says fly, it stays on the ground or jumps",)


@pytest.mark.parametrize(
    ("plan", "sentence", "said"),
    [
        (PERSON, "a person walks forward, then waves with the left hand", ""),
        (DOG, "a dog walks forward", ""),
        (DOG, "a dog waves with the left hand", "stands on them"),
        (DOG, "walks forward, then claps", "claps"),
        (FISH, "runs", "moves legs, and none"),
        (FISH, "a fish waves", "moves arms, and none"),
        (PERSON, "flies away", "needs wings"),
        (BIRD, "a bird flies", ""),
        (FISH, "a fish swims", ""),
        (FISH, "walks", "it swims instead"),
        (SNAKE, "a snake runs", "it slithers instead"),
        (SNAKE, "slithers", ""),
        (DOG, "swims", "paddles as it walks"),
        (DOG, "a dog slithers", "walks slowly instead"),
        (DOG, "crawls", ""),
        (BIRD, "crawls", "needs forelegs or arms"),
        (PERSON, "slithers", "crawls instead"),
        (PERSON, "swims", ""),
        (BIRD, "waves", ""),
    ],
)
def test_what_a_sentence_asks_in_vain_is_said(plan, sentence, said):
    notes = adapt_sentence(parse(sentence), plan).cannot
    assert (said in " ".join(notes)) if said else not notes


@pytest.mark.parametrize(
    ("plan", "clause", "said", "way"),
    [
        (SNAKE, "a snake runs ahead", "a snake slithers fast ahead", "slither fast"),
        (SNAKE, "crawls", "slithers", "slither"),
        (FISH, "walks forward", "swims forward", "swim"),
        (FISH, "swims", "swims", "swim"),
        (BEE, "flies", "flies", "fly"),
        (BEE, "walks forward", "flies forward", "fly on"),
        (DOG, "crawls", "walks slowly", ""),
        (DOG, "swims", "walks", ""),
        (DOG, "flies", "flies", ""),
        (DOG, "walks", "walks", ""),
        (PERSON, "crawls", "crawls", ""),
        (PERSON, "slithers", "crawls", ""),
        (PERSON, "swims", "swims", ""),
        (MERMAID, "walks", "walks", ""),
        (SNAKE, "bites", "bites", ""),
        (SPIDER, "a spider runs", "a spider walks fast", ""),
        (SPIDER, "crawls", "walks", ""),
        (RAY, "walks", "swims", "swim"),
    ],
)
def test_each_body_does_it_in_its_own_way(plan, clause, said, way):
    (done,) = for_body(parse(clause, force=True), body_kind(plan), ["wings"] if plan.wings else []).clauses
    assert done.text.removeprefix("a bird ").removeprefix("a person ") == said
    assert done.moves == way if way else done.moves not in ("fly", "swim", "slither")


def test_a_mesh_that_crouches_first_stands_as_it_does_later():
    person = make_sample("person", 0.3)
    low = person.vertices * [1, 0.5, 1]
    moving = np.stack([low] * 20 + [person.vertices] * 20).astype(np.float32)
    np.testing.assert_array_equal(_standing(MeshMotion(moving, person.faces)).vertices, person.vertices)
    moving = moving[::-1] + np.linspace(0, 0.01, 40)[:, None, None].astype(np.float32)
    np.testing.assert_array_equal(_standing(MeshMotion(moving, person.faces)).vertices, moving[0])
