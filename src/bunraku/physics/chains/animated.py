"""The apparel of an animation: as it is, or simulated by the physics of its character's file, or by chains that its
bones become.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError
from bunraku.physics.chains.moving import moving_rig, steady_simulation
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.simulate import simulate

__all__ = ["check_apparel", "simulated", "with_apparel"]

Progress = Callable[[str, float], None]
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
