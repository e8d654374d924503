"""The motion of one creature on another: from how the one stands to how the other stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.joints import find_joints
from bunraku.anatomy.plan import check_plans, plan_of
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
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


def fit_creature(source: CreatureMotion, character: Character, handles: Handles, stages: Stages) -> Animation:
    """A creature's motion on the handles of a character.

    Args:
        source: The motion.
        character: Facing +Z, standing.
        handles: Its handles, K = 30 with the reference body's meaning.
        stages: Which stages run.

    Raises:
        CharacterError: The character lacks what carries the source (see `check_plans`).
    """
    plan = plan_of(character, handles, find_joints(character, handles))
    if not source.suits(plan):
        assert source.person is not None
        return Animation(character, handles, fit_motion(source.person, character, handles, stages), source.person)
    check_plans(source.plan, plan, character.name, source.flies)
    fitted = fit_motion(source.motion, character, handles, _own_stages(stages), heights=_heights(source))
    return Animation(character, handles, fitted, motion_to_reference(fitted, character, handles, native=True))


def fit_creature_rig(source: CreatureMotion, parts: RigParts, stages: Stages) -> RigAnimation:
    """A creature's motion on the bones of a character.

    Args:
        source: The motion.
        parts: The character's rig.
        stages: Which stages run.

    Raises:
        CharacterError: The character lacks what carries the source (see `check_plans`).
    """
    plan = plan_of(parts.character, parts.handles, parts.joints)
    if not source.suits(plan):
        assert source.person is not None
        return fit_rig(source.person, parts, stages)
    check_plans(source.plan, plan, parts.character.name, source.flies)
    still = replace(parts, rotations=np.tile(np.eye(3), (len(parts.rotations), 1, 1)))
    moved = fit_rig(source.motion, still, _own_stages(stages), heights=_heights(source))
    return replace(moved, reference=None)
