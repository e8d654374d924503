"""Apparel that moves with an animation by the physics of its character's file, or by chains of its bones."""

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

# Chosen by eye.
TRIES = 3  # how often such bodies are simulated again
STIFFER = 4.0  # factor on their stiffness, each time; steps are half as long
_log = logging.getLogger(__name__)


def moving_rig(character: Character, stiffness: float = 1.0, gravity: float = 1.0) -> ApparelRig | None:
    """What physics move of a character: what its file says, or else the bones of its hair and clothes; None for
    neither. FormatError if the nodes of its file are broken.
    """
    if character.rig is None:
        return None
    rig = apparel_rig(character)
    if rig is not None:
        return dialled(rig, stiffness, gravity)
    chains = bone_chains(character, stiffness, gravity)
    return chain_rig(chains, character.rig.positions) if chains else None


def dialled(rig: ApparelRig, stiffness: float = 1.0, gravity: float = 1.0) -> ApparelRig:
    """The same with factors on gravity and on springs of rotations; limits are narrower by the root of that."""
    if stiffness == gravity == 1:
        return rig
    narrow = float(np.clip(stiffness, 0.01, 1000.0) ** -0.5)
    joints = []
    for joint in rig.joints:
        low, high = joint.angle_lower, joint.angle_upper
        lower, upper = (np.where(low <= high, limit * narrow, limit) for limit in (low, high))
        spring = joint.angle_spring * stiffness
        joints.append(replace(joint, angle_spring=spring, angle_lower=lower, angle_upper=upper))
    pulls = rig.gravity
    if gravity != 1:
        world = np.tile([0.0, -PhysicsSettings().gravity, 0.0], (len(rig.bodies), 1))
        pulls = (world if pulls is None else pulls) * gravity
    return replace(rig, joints=tuple(joints), gravity=pulls)


def steady_simulation(
    animation: RigAnimation, rig: ApparelRig, *, settings: PhysicsSettings | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:  # fmt: skip
    """`simulate` for chains without an artist's tuning: bodies that fly off are simulated again, stiffer and in shorter
    steps than in `settings`, and those that still do stay with the body.
    """
    settings = settings or PhysicsSettings()
    for attempt in range(2 * TRIES):
        result = simulate(animation, rig, settings=settings, progress=progress)
        lost = {recovery.body for recovery in result.report.recoveries if recovery.frame >= 0}
        if not lost:
            return result
        if attempt < TRIES:
            rig = _stiffer(rig, lost)
            settings = replace(settings, step=settings.step / 2)
            continue
        bodies = tuple(replace(body, mode=0) if body.name in lost else body for body in rig.bodies)
        rig = replace(rig, bodies=bodies)
        if not rig.dynamic:
            break
    return Simulation(animation, replace(result.report, recoveries=()))


def _stiffer(rig: ApparelRig, names: set[str]) -> ApparelRig:
    """The joints of some bodies, and of those tied to them, stiffer and narrower."""
    chosen = {number for number, body in enumerate(rig.bodies) if body.name in names}
    stiffened = dialled(rig, STIFFER)
    joints = tuple(
        stiff if set(joint.bodies) & chosen else joint
        for joint, stiff in zip(rig.joints, stiffened.joints, strict=True)
    )
    return replace(rig, joints=joints)


def check_apparel(character: Character) -> None:
    """Check that there is apparel to simulate. CharacterError if its file says nothing of physics, and it has no bones
    of hair or clothes; FormatError if the nodes of the file are broken.
    """
    if moving_rig(character) is None:
        raise CharacterError(
            f"{character.name}: nothing of this character is moved by physics; its file must be a PMX, PMD or VRM "
            "with rigid bodies or springs, or have a person's rig with bones of hair or clothes"
        )


def with_apparel(
    animation: Animation | RigAnimation, progress: Progress | None = None, stiffness: float = 1.0, gravity: float = 1.0
) -> RigAnimation:
    """The animation of bones with its apparel simulated, with factors on stiffness and gravity; problems are logged.
    CharacterError if there is no physics in its file and there are no bones to simulate, or it is moved by handles.
    """
    character = animation.character
    check_apparel(character)
    if not isinstance(animation, RigAnimation):
        raise CharacterError(
            f"{character.name}: apparel is simulated on the bones of a humanoid's rig, and this one is moved by "
            "handles; try --onto rig"
        )
    progress = progress or (lambda stage, done: None)
    progress("apparel", 0.0)
    rig = moving_rig(character, stiffness, gravity)
    assert rig is not None
    run = simulate if apparel_rig(character) is not None else steady_simulation
    result = run(animation, rig, progress=partial(progress, "apparel"))
    for problem in result.report.problems():
        _log.warning("%s: %s", character.name, problem)
    return result.animation
