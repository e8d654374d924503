"""A generated motion on a character: facts about its body, sentences and motions adapted to them, and the way back from
an animation to what was generated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.corrected import PARTS
from bunraku.anatomy.legs import BodyPlan
from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.motion import HandleMotion
from bunraku.core.request import Constraint, Progress
from bunraku.core.travel import GroundPath, bent_to_path, follow
from bunraku.core.travel import in_place as in_place_motion
from bunraku.language.parse import for_body, instead_of_walking
from bunraku.language.sentence import Sentence
from bunraku.pipelines.requests import Constraints
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.locomotion import moved_so
from bunraku.retarget.pins import meet_pins
from bunraku.retarget.stages.feet import Feet

if TYPE_CHECKING:
    from bunraku.retarget.rig_parts import RigParts

GENERATED_STAGES = Stages(shape=True)
"""The stages that run by default."""


def apply_motion(
    motion: HandleMotion, anatomy: Anatomy, constraints: Iterable[Constraint] = (), stages: Stages | None = None,
    progress: Progress | None = None,
) -> Animation:  # fmt: skip
    """A motion of the reference body, as `generate` makes them for the same constraints, on a character: as a loop,
    along `reference_path`, after the same motion. `GENERATED_STAGES` fit it when `stages` is None.
    """
    progress = progress or (lambda stage, done: None)
    progress("fit", 0.0)
    constraints = Constraints(constraints)
    after, loop, path = constraints.after, constraints.loop, constraints.path
    before = None if isinstance(after, HandleMotion) else after
    stages = stages or GENERATED_STAGES
    # The way back from a clip contains the effect of two stages; hands that are not a person's miss what they touch.
    anew = before is None or before.reference is not None
    hands = stages.hands or anatomy.leap > anatomy.scale
    stages = replace(stages, shape=stages.shape and anew, leap=stages.leap and anew, hands=hands)
    fitted = fitted_motion(motion, anatomy, stages, loop)
    if before is not None:
        fitted = follow(fitted, before.motion)
        if stages.feet:
            fitted = Feet().continued(fitted, before.motion, anatomy)
    if constraints.in_place or (path is None and _leaves_base(fitted, anatomy)):
        fitted = in_place_motion(fitted, loop)
    if path is not None:
        low = float(anatomy.character.vertices[:, 1].min())
        fitted = bent_to_path(fitted, path, size=float(anatomy.handles.positions[0, 1]) - low)
    if constraints.pins:
        fitted = meet_pins(fitted, anatomy, constraints.pins)
    progress("fit", 1.0)
    return Animation(anatomy.character, anatomy.handles, fitted, motion)


STEP = 0.1
"""A base higher than this, over the body's height, is no step down; chosen by eye on two statues on their plinths."""


def _leaves_base(motion: HandleMotion, anatomy: Anatomy) -> bool:
    """Whether a path leads off the base that a body stands on, so that it would go on in the air."""
    beside, deep = anatomy.character.beside, STEP * anatomy.mesh.height
    if beside is None:
        return False
    ground = anatomy.character.vertices[beside]
    top = ground[np.abs(ground[:, 1] - anatomy.floor) < deep][:, [0, 2]]
    if not len(top) or ground[:, 1].min() > anatomy.floor - deep:
        return False
    path = (motion.root_translation + anatomy.handles.positions[0])[:, [0, 2]]
    return bool(((path < top.min(axis=0)) | (path > top.max(axis=0))).any())


def apply_rigged(
    motion: HandleMotion, parts: RigParts, constraints: Iterable[Constraint] = (), stages: Stages | None = None,
    progress: Progress | None = None,
) -> RigAnimation:  # fmt: skip
    """A motion of the reference body on the bones of a character, hair and clothes going along. The bones count as 30
    handles; the stage `shape` is left out, since bones keep their lengths. A clip that is followed moves the bones of
    the same rig.
    """
    from bunraku.retarget.to_reference import handle_animation
    from bunraku.retarget.to_rig import on_bones, stiff

    constraints = Constraints(constraints)
    after = constraints.after
    if isinstance(after, RigAnimation):
        constraints = constraints.following(handle_animation(after))
    stages = replace(stages or Stages(), shape=False)
    return on_bones(parts, apply_motion(stiff(motion), parts.anatomy, constraints, stages, progress).motion, motion)


def reference_path(path: GroundPath | None, anatomy: Anatomy) -> GroundPath | None:
    """A path for a character as one for the reference body, whose strides have another length."""
    return None if path is None else path.moved(1 / anatomy.scale)


def fitted_motion(motion: HandleMotion, anatomy: Anatomy, stages: Stages | None, loop: bool = False) -> HandleMotion:
    """`fit_motion`; a loop is fitted with its rounds before and after, so that no stage treats its ends as ends."""
    if not loop or len(motion) < 3:
        return fit_motion(motion, anatomy, stages)
    from bunraku.core.travel import closed_loop, repeated

    margin = round(2 * motion.fps)
    fitted = fit_motion(repeated(motion, margin, margin), anatomy, stages)
    return closed_loop(fitted.take(slice(margin, margin + len(motion))), motion)


def reference_of(animation: AnimatedCharacter, anatomy: Anatomy | None = None) -> HandleMotion:
    """The motion of the reference body that an animation of 30 handles plays: the one that it was fitted from, or else
    its own taken back. The anatomy, of its character by its handles, is found where it is needed and None.
    """
    if animation.reference is not None:
        return animation.reference
    from bunraku.retarget.to_reference import motion_to_reference

    return motion_to_reference(animation.motion, anatomy or Anatomy.of(animation.character, animation.handles))


LEAST = 0.004
"""Share of the surface above which a part, or apparel, counts as found; chosen by eye."""
SURE, LIKELY = 0.85, 0.7
"""Mean weight of a part's handles over the part from which on it is called sure, and likely; chosen by eye."""


@dataclass(frozen=True)
class PartFact:
    """A part of a body as it was found, such as "left leg": its share of the surface, and how clearly the part's
    handles hold it, the mean of their weights over it, 0 to 1.
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
    """What was decided about a body: its plan, what was found, largest first, and what such a body cannot do, a
    sentence each.
    """

    plan: BodyPlan
    parts: tuple[PartFact, ...]
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
    return BodyFacts(plan, tuple(parts), tuple(_cannot(plan, [part.name for part in parts])))


def _cannot(plan: BodyPlan, parts: list[str]) -> list[str]:
    out = []
    if not plan.legs:
        seen = "its legs do not stand on the ground" if {"left leg", "right leg"} & set(parts) else "no legs are found"
        out.append(f"{seen}: where a sentence says walk or run, it {instead_of_walking(body_kind(plan))} instead")
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
    return "snake" if plan.slithers else "fish" if plan.swims else "bird in flight" if plan.wings else "no legs"


def adapt_sentence(sentence: Sentence, plan: BodyPlan) -> Sentence:
    """A sentence as a body of this plan does it."""
    there = {"arms": plan.arms, "forelegs": plan.front, "wings": plan.wings}
    return for_body(sentence, body_kind(plan), [part for part, has in there.items() if has], moves_as_people(plan))


def moves_as_people(plan: BodyPlan) -> bool:
    """Whether a body moves as people do."""
    return plan.upright


def adapt_to_body(sentences: Sequence[Sentence], anatomy: Anatomy) -> tuple[list[Sentence], bool]:
    """Parsed sentences as a body does them, and whether it moves as people do."""
    plan = anatomy.plan
    return [adapt_sentence(sentence, plan) for sentence in sentences], moves_as_people(plan)


def apply_locomotion(motion: HandleMotion, sentence: Sentence, anatomy: Anatomy, loop: bool = False) -> HandleMotion:
    """A generated motion of the reference body with what its locomotion needs, as the sentence shows it that was
    adapted to the body: wings that beat in the air, a wave along the body, feet on the ground.
    """
    start = 0.0
    for locomotion, clauses in groupby(sentence.clauses, key=lambda clause: clause.moves):
        share = sum(clause.seconds / sentence.seconds for clause in clauses)
        where = slice(round(start * len(motion)), round((start + share) * len(motion)))
        if locomotion:
            motion = moved_so(motion, locomotion, where, anatomy, loop)
        start += share
    return motion
