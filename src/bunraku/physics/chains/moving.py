"""What physics move of a character: the rigid bodies or springs of its file, or else the chains of its bones. And the
simulation of chains, which shows nothing that flies off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.chains.chain_rig import chain_rig
from bunraku.physics.chains.from_bones import bone_chains
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.settings import PhysicsSettings
from bunraku.physics.simulate import Simulation, simulate

__all__ = ["dialled", "moving_rig", "steady_simulation"]

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
    animation: RigAnimation,
    rig: ApparelRig,
    *,
    settings: PhysicsSettings | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
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
