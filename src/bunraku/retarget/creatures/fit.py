"""The motion of one creature on another: from how the one stands to how the other stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.plan import check_plans
from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.retarget.creatures.motion import CreatureMotion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.reference import motion_to_reference
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.to_rig import fit_rig

__all__ = ["fit_creature", "fit_creature_rig"]


def _own_stages(stages: Stages) -> Stages:
    """The stages, without those that compare with a person: both bodies stand in their rest poses."""
    return replace(stages, rest_pose=False, hands=False)


def _heights(source: CreatureMotion) -> np.ndarray | None:
    """How high what stands is over the ground; None of what flies, swims or slides, which keeps the height of its
    path.
    """
    return source.heights if source.plan.legs and not source.flies else None


def fit_creature(source: CreatureMotion, anatomy: Anatomy, stages: Stages) -> Animation:
    """A creature's motion on the handles of a character.

    Args:
        source: The motion.
        anatomy: Of the character, which stands in its rest pose.
        stages: Which stages run.

    Raises:
        CharacterError: The character lacks what carries the source (see `check_plans`).
    """
    character, handles = anatomy.character, anatomy.handles
    if not source.suits(anatomy.plan):
        assert source.person is not None
        return Animation(character, handles, fit_motion(source.person, anatomy, stages), source.person)
    check_plans(source.plan, anatomy.plan, character.name, source.flies)
    fitted = fit_motion(source.motion, anatomy, _own_stages(stages), _heights(source))
    return Animation(character, handles, fitted, motion_to_reference(fitted, anatomy, own=True))


def fit_creature_rig(source: CreatureMotion, parts: RigParts, stages: Stages) -> RigAnimation:
    """A creature's motion on the bones of a character.

    Args:
        source: The motion.
        parts: The character's rig.
        stages: Which stages run.

    Raises:
        CharacterError: The character lacks what carries the source (see `check_plans`).
    """
    plan = parts.anatomy.plan
    if not source.suits(plan):
        assert source.person is not None
        return fit_rig(source.person, parts, stages)
    check_plans(source.plan, plan, parts.character.name, source.flies)
    moved = fit_rig(source.motion, parts, _own_stages(stages), heights=_heights(source))
    return replace(moved, reference=None)
