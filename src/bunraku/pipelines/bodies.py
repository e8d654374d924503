"""Sentences on bodies that are no person's: what each does in its place, and what such a movement needs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.motion import HandleMotion
from bunraku.language.sentence import Sentence
from bunraku.pipelines.decisions import moves_as_people, suited
from bunraku.retarget.creatures.ways import moved_so

__all__ = ["as_bodies_do", "moved_ways"]


def as_bodies_do(sentences: Sequence[Sentence], anatomy: Anatomy) -> tuple[list[Sentence], bool]:
    """Sentences as a body does them, and whether it moves as people do.

    Args:
        sentences: From `language.parse`.
        anatomy: Of the body.
    """
    plan = anatomy.plan
    return [suited(sentence, plan) for sentence in sentences], moves_as_people(plan)


def moved_ways(motion: HandleMotion, sentence: Sentence, anatomy: Anatomy, loop: bool = False) -> HandleMotion:
    """A generated motion with what its ways of moving need: wings that beat in the air, a wave along the body, feet on
    the ground.

    Args:
        motion: Of the reference body.
        sentence: What it shows, as the body does it.
        anatomy: Of the character.
        loop: Whether the motion is a loop.
    """
    start, whole = 0.0, sentence.seconds
    for way, clauses in groupby(sentence.clauses, key=lambda clause: clause.moves):
        share = sum(clause.seconds / whole for clause in clauses)
        where = slice(round(start * len(motion)), round((start + share) * len(motion)))
        motion = moved_so(motion, way, where, anatomy, loop)
        start += share
    return motion
