"""The apparel of an animation: as it is, or simulated by the physics of its character's file or by chains."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from bunraku.apparel.chains.chain_rig import chain_rig
from bunraku.apparel.chains.from_bones import bone_chains
from bunraku.apparel.physics.rig import ApparelRig, PhysicsSettings, apparel_rig
from bunraku.apparel.physics.simulate import Simulation, simulate
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Character
from bunraku.core.request import Progress
from bunraku.errors import CharacterError

__all__ = ["check_apparel", "dialled", "moving_rig", "simulated", "steady_simulation", "with_apparel"]

TRIES = 3
"""How often what flies off is simulated again."""
STIFFER = 4.0
"""Factor on the stiffness of what flew off, each time; steps are half as long."""


def moving_rig(character: Character, stiffness: float = 1.0, gravity: float = 1.0) -> ApparelRig | None:
    """What physics move of a character: what its file says, or else the bones of its hair and clothes; None where it
    has neither.

    Args:
        character: With a rig.
        stiffness: Factor on how stiff it is.
        gravity: Factor on gravity.

    Raises:
        FormatError: The nodes of its file are broken.
    """
    if character.rig is None:
        return None
    found = apparel_rig(character)
    if found is not None:
        return dialled(found, stiffness, gravity)
    chains = bone_chains(character, stiffness, gravity)
    return chain_rig(chains, character.rig.positions) if chains else None


def dialled(rig: ApparelRig, stiffness: float = 1.0, gravity: float = 1.0) -> ApparelRig:
    """The same with springs so many times as stiff and limits narrower by the root of that, in the part of them that
    turns; and gravity so many times as strong.
    """
    if stiffness == gravity == 1:
        return rig
    narrow = float(np.clip(stiffness, 0.01, 1000.0) ** -0.5)
    joints = tuple(
        replace(
            joint, angle_spring=joint.angle_spring * stiffness,
            angle_lower=np.where(joint.angle_lower <= joint.angle_upper, joint.angle_lower * narrow, joint.angle_lower),
            angle_upper=np.where(joint.angle_lower <= joint.angle_upper, joint.angle_upper * narrow, joint.angle_upper),
        )
        for joint in rig.joints
    )  # fmt: skip
    pulls = rig.gravity
    if gravity != 1:
        if pulls is None:
            pulls = np.tile([0.0, -PhysicsSettings().gravity, 0.0], (len(rig.bodies), 1))
        pulls = pulls * gravity
    return replace(rig, joints=joints, gravity=pulls)


def steady_simulation(
    animation: RigAnimation, rig: ApparelRig, *, settings: PhysicsSettings | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:  # fmt: skip
    """`simulate` for chains that nobody has tuned: what flies off is simulated again, stiffer and in shorter steps, and
    what still does stays with the body.

    Args:
        animation: The motion of the rig.
        rig: Its bodies and joints.
        settings: Of the first try.
        progress: Called with the share done of each try.
    """
    settings = settings or PhysicsSettings()
    for attempt in range(2 * TRIES):
        found = simulate(animation, rig, settings=settings, progress=progress)
        lost = {one.body for one in found.report.recoveries if one.frame >= 0}
        if not lost:
            return found
        if attempt < TRIES:
            rig = _stiffer(rig, lost)
            settings = replace(settings, step=settings.step / 2)
            continue
        bodies = tuple(replace(body, mode=0) if body.name in lost else body for body in rig.bodies)
        rig = replace(rig, bodies=bodies)
        if not rig.dynamic:
            break
    return Simulation(animation, replace(found.report, recoveries=()))


def _stiffer(rig: ApparelRig, names: set[str]) -> ApparelRig:
    """The joints of some bodies, and of those tied to them, stiffer and narrower."""
    chosen = {number for number, body in enumerate(rig.bodies) if body.name in names}
    whole = dialled(rig, STIFFER)
    joints = tuple(
        stiff if set(joint.bodies) & chosen else joint for joint, stiff in zip(rig.joints, whole.joints, strict=True)
    )
    return replace(rig, joints=joints)


_log = logging.getLogger(__name__)


def check_apparel(character: Character) -> None:
    """Whether there is apparel to simulate.

    Raises:
        CharacterError: The file of the character says nothing of physics, and has no bones of hair or clothes.
        FormatError: The nodes of the file are broken.
    """
    if moving_rig(character) is None:
        raise CharacterError(
            f"{character.name}: nothing of this character is moved by physics; its file must be a PMX, PMD or VRM "
            "with rigid bodies or springs, or have a person's rig with bones of hair or clothes"
        )


def with_apparel(
    animation: Animation | RigAnimation, progress: Progress | None = None, stiffness: float = 1.0, gravity: float = 1.0
) -> RigAnimation:
    """The animation with its apparel simulated.

    Args:
        animation: Of bones.
        progress: Called with a stage's name and the share done.
        stiffness: Factor on how stiff it is.
        gravity: Factor on gravity.

    Raises:
        CharacterError: There is no physics in its file and there are no bones to simulate, or it is moved by handles.
    """
    check_apparel(animation.character)
    if not isinstance(animation, RigAnimation):
        name = animation.character.name
        raise CharacterError(
            f"{name}: apparel is simulated on the bones of a humanoid's rig, and this one is moved by handles; try "
            "--onto rig"
        )
    return simulated(animation, progress, stiffness, gravity)


def simulated(
    animation: RigAnimation, progress: Progress | None = None, stiffness: float = 1.0, gravity: float = 1.0
) -> RigAnimation:
    """The animation with its apparel simulated; what went wrong is logged. Arguments are those of `with_apparel`.

    Raises:
        CharacterError: There is no physics in its file.
    """
    progress = progress or (lambda stage, done: None)
    progress("apparel", 0.0)
    tell = partial(progress, "apparel")
    rig = moving_rig(animation.character, stiffness, gravity)
    told = apparel_rig(animation.character) is not None or rig is None
    found = simulate(animation, rig, progress=tell) if told or rig is None else steady_simulation(
        animation, rig, progress=tell)  # fmt: skip
    for problem in found.report.problems():
        _log.warning("%s: %s", animation.character.name, problem)
    return found.animation
