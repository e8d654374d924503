"""Facts about a body, and how sentences and motions are adapted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.corrected import PARTS
from bunraku.anatomy.legs import BodyPlan
from bunraku.core.motion import HandleMotion
from bunraku.language.parse import INSTEAD, for_body
from bunraku.language.sentence import Sentence
from bunraku.retarget.locomotion import moved_so

LEAST = 0.004
"""Share of the surface above which a part, or apparel, counts as found; chosen by eye."""
SURE, LIKELY = 0.85, 0.7
"""Mean weight of a part's handles over the part from which on it is called sure, and likely; chosen by eye."""


@dataclass(frozen=True)
class PartFact:
    """A part of a body as it was found.

    Args:
        name: Such as "left leg".
        area: Share of the surface.
        sure: How clearly the part's handles hold it: the mean of their weights over it, 0 to 1.
    """

    name: str
    area: float
    sure: float

    @property
    def words(self) -> str:
        """The same in words."""
        certainty = "sure" if self.sure >= SURE else "likely" if self.sure >= LIKELY else "a guess"
        return f"{self.name}: {100 * self.area:.0f} % of the surface, {100 * self.sure:.0f} % clear ({certainty})"


@dataclass(frozen=True)
class BodyFacts:
    """What was decided about a body.

    Args:
        plan: What it stands and moves with.
        parts: What was found, largest first.
        further: How many legs it has beyond two or four.
        cannot: What such a body cannot do, a sentence each.
    """

    plan: BodyPlan
    parts: tuple[PartFact, ...]
    further: int
    cannot: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """The same in words, a line each."""
        return [self.plan.words, *(part.words for part in self.parts), *self.cannot]


def body_facts(anatomy: Anatomy) -> BodyFacts:
    """What was decided about a character's body."""
    plan, character, handles = anatomy.plan, anatomy.character, anatomy.handles
    areas = character.areas / max(float(character.areas.sum()), 1e-30)
    main, played = handles.weights.argmax(axis=1), handles.played
    parts = []
    for name, members in PARTS.items():
        inside = np.isin(played, members)
        held = inside[main] & (areas > 0)
        area = float(areas[held].sum())
        if area > LEAST:
            clear = float((areas[held] * handles.weights[held][:, inside].sum(axis=1)).sum() / area)
            shown = "trunk" if name == "body" else name.replace("arm", "foreleg") if plan.front else name
            parts.append(PartFact(shown, area, clear))
    parts.sort(key=lambda part: -part.area)
    return BodyFacts(plan, tuple(parts), len(anatomy.further), tuple(_cannot(plan, [part.name for part in parts])))


def _cannot(plan: BodyPlan, parts: list[str]) -> list[str]:
    out = []
    if not plan.legs:
        seen = "its legs do not stand on the ground" if {"left leg", "right leg"} & set(parts) else "no legs are found"
        out.append(f"{seen}: where a sentence says walk or run, it {INSTEAD[body_kind(plan)]} instead")
    if plan.front:
        out.append("it stands on its forelegs: where a sentence says wave, clap or hold, it hardly lifts them")
    elif not plan.arms and not plan.wings:
        out.append("no arms are found: where a sentence says wave, clap or hold, it moves its trunk and head")
    if not plan.wings:
        out.append("no wings are found: where a sentence says fly, it stays on the ground or jumps")
    return out


def body_kind(plan: BodyPlan) -> str:
    """The kind of a body, as `language.bodies` has them."""
    if plan.legs:
        return plan.kind
    return "snake" if plan.slithers else "fish" if plan.swims else "no legs"


def adapt_sentence(sentence: Sentence, plan: BodyPlan) -> Sentence:
    """A sentence as a body of this plan does it."""
    there = {"arms": plan.arms, "forelegs": plan.front, "wings": plan.wings}
    return for_body(sentence, body_kind(plan), [part for part, has in there.items() if has], moves_as_people(plan))


def moves_as_people(plan: BodyPlan) -> bool:
    """Whether a body moves as people do."""
    return plan.upright and not plan.swims


def adapt_to_body(sentences: Sequence[Sentence], anatomy: Anatomy) -> tuple[list[Sentence], bool]:
    """Parsed sentences as a body does them, and whether it moves as people do."""
    plan = anatomy.plan
    return [adapt_sentence(sentence, plan) for sentence in sentences], moves_as_people(plan)


def apply_locomotion(motion: HandleMotion, sentence: Sentence, anatomy: Anatomy, loop: bool = False) -> HandleMotion:
    """A generated motion with what its locomotion needs: wings that beat in the air, a wave along the body, feet on
    the ground.

    Args:
        motion: Of the reference body.
        sentence: What it shows, adapted to the body.
        anatomy: Of the character.
        loop: Whether the motion is a loop.
    """
    start = 0.0
    for locomotion, clauses in groupby(sentence.clauses, key=lambda clause: clause.moves):
        share = sum(clause.seconds / sentence.seconds for clause in clauses)
        where = slice(round(start * len(motion)), round((start + share) * len(motion)))
        motion = moved_so(motion, locomotion, where, anatomy, loop)
        start += share
    return motion
