"""Sentences on bodies that are no person's: what each does in its place, and what such a movement needs."""

from __future__ import annotations

from collections.abc import Sequence

from bunraku.body.layout import HANDLE_COUNT
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.language.clauses import of_creature
from bunraku.pipelines.decisions import suited
from bunraku.retarget.creatures.plan import plan_of
from bunraku.retarget.creatures.ways import moved_so
from bunraku.retarget.decimate import decimated
from bunraku.retarget.stages.attach import find_joints

__all__ = ["Ways", "as_bodies_do", "moved_ways"]

Script = Sequence[tuple[str, float]]
Ways = list[tuple[str, float]]
"""The ways of moving of the clauses of a sentence, "" for none, with their shares of its time."""


def as_bodies_do(
    scripts: Sequence[Script], character: Character, handles: Handles
) -> tuple[list[list[tuple[str, float]]], list[Ways]]:
    """The clauses of sentences in words for what this body does in their place, and the way of moving of each.

    Args:
        scripts: The clauses of each sentence with their seconds.
        character: Facing +Z.
        handles: Its handles.
    """
    if len(handles.positions) != HANDLE_COUNT:  # what `fit_motion` refuses
        return [list(script) for script in scripts], [[] for _ in scripts]
    character, handles = decimated(character, handles)
    plan = plan_of(character, handles, find_joints(character, handles))
    out: list[list[tuple[str, float]]] = []
    ways: list[Ways] = []
    for script in scripts:
        words = [suited(plan, clause) for clause, _ in script]
        seconds = [length for _, length in script]
        said = [clause if plan.upright else of_creature(clause) for clause, _ in words]
        out.append(list(zip(said, seconds, strict=True)))
        ways.append([(way, length / sum(seconds)) for (_, way), length in zip(words, seconds, strict=True)])
    return out, ways


def moved_ways(
    motion: HandleMotion, ways: Ways, character: Character, handles: Handles, loop: bool = False
) -> HandleMotion:
    """A generated motion with what its ways of moving need: wings that beat in the air, a wave along the body.

    Args:
        motion: Of the reference body.
        ways: Of the sentence.
        character: Facing +Z.
        handles: Its handles.
        loop: Whether the motion is a loop.
    """
    start = 0.0
    for way, share in ways:
        where = slice(round(start * len(motion)), round((start + share) * len(motion)))
        motion = moved_so(motion, way, where, character, handles, loop)
        start += share
    return motion
