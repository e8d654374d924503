"""Sentences on bodies that are no person's: what each does in its place, and what such a movement needs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.plan import BodyPlan
from bunraku.core.motion import HandleMotion
from bunraku.language.clauses import of_creature, subject_of, with_subject
from bunraku.language.ways import in_air, way_of
from bunraku.pipelines.decisions import suited
from bunraku.retarget.creatures.ways import moved_so

__all__ = ["Ways", "as_bodies_do", "moved_ways"]

Script = Sequence[tuple[str, float]]
Ways = list[tuple[str, float]]
"""The ways of moving of the clauses of a sentence, "" for none, with their shares of its time."""


def as_bodies_do(scripts: Sequence[Script], anatomy: Anatomy) -> tuple[list[list[tuple[str, float]]], list[Ways], bool]:
    """The clauses of sentences in words for what this body does in their place, the way of moving of each, and whether
    the body moves as people do.

    What is said of a person is said of "it" where it does not: conditioned on a person's words, the network lets a dog
    walk on two legs.

    Args:
        scripts: The clauses of each sentence with their seconds.
        anatomy: Of the body.
    """
    plan = anatomy.plan
    as_people = plan.upright and not plan.swims
    out: list[list[tuple[str, float]]] = []
    ways: list[Ways] = []
    for script in scripts:
        words = [_on_ground(plan, *suited(plan, clause)) for clause, _ in script]
        seconds = [length for _, length in script]
        said = [
            _of_bird(clause) if way == "fly" else clause if as_people else _of_kind(clause) for clause, way in words
        ]
        out.append(list(zip(said, seconds, strict=True)))
        ways.append([(way, length / sum(seconds)) for (_, way), length in zip(words, seconds, strict=True)])
    return out, ways, as_people


def _on_ground(plan: BodyPlan, clause: str, way: str) -> tuple[str, str]:
    """A clause and its way of moving; of one that has none, how it is on the ground."""
    ground = in_air(clause)
    return clause, way or ("lie" if ground and plan.slithers else ground)


def _of_kind(clause: str) -> str:
    """A clause said of a creature, and one of walking or running of "it", whichever is named: the network has seen few
    kinds walk, and a rat or a frog that is named hardly stirs.
    """
    subject, rest = subject_of(clause)
    return f"it {rest}" if subject and way_of(clause) in ("walk", "run") else of_creature(clause)


def _of_bird(clause: str) -> str:
    """A clause of flight said of a bird: the one flight that the network knows, whoever has the wings."""
    subject, rest = subject_of(clause)
    return f"a bird {rest}" if subject else with_subject(clause, "a bird")


def moved_ways(motion: HandleMotion, ways: Ways, anatomy: Anatomy, loop: bool = False) -> HandleMotion:
    """A generated motion with what its ways of moving need: wings that beat in the air, a wave along the body, feet on
    the ground.

    Args:
        motion: Of the reference body.
        ways: Of the sentence.
        anatomy: Of the character.
        loop: Whether the motion is a loop.
    """
    start = 0.0
    for way, shares in groupby(ways, key=lambda one: one[0]):
        share = sum(one[1] for one in shares)
        where = slice(round(start * len(motion)), round((start + share) * len(motion)))
        motion = moved_so(motion, way, where, anatomy, loop)
        start += share
    return motion
