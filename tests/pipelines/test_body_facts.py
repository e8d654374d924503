"""What was decided about a body, and what it cannot do."""

from __future__ import annotations

import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.plan import BodyPlan
from bunraku.body.reference import reference_body
from bunraku.language.bodies import for_body
from bunraku.language.parse import parse
from bunraku.pipelines.bodies import body_facts, kind_of, suited
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.synthetic.samples import make_sample

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
    assert all(0.5 < part.sure <= 1 for part in facts.parts) and facts.further == 0
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
    notes = suited(parse(sentence), plan).cannot
    assert (said in " ".join(notes)) if said else not notes


@pytest.mark.parametrize(
    ("plan", "clause", "said", "way"),
    [
        (SNAKE, "a snake runs ahead", "a snake slithers fast ahead", "slither"),
        (SNAKE, "crawls", "slithers", "slither"),
        (FISH, "walks forward", "swims forward", "swim"),
        (FISH, "swims", "swims", "swim"),
        (BEE, "flies", "flies", "fly"),
        (BEE, "walks forward", "walks forward", ""),
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
    (done,) = for_body(parse(clause, force=True), kind_of(plan), ["wings"] if plan.wings else []).clauses
    assert done.text.removeprefix("a bird ").removeprefix("a person ") == said
    assert done.moves == way if way else done.moves not in ("fly", "swim", "slither")
