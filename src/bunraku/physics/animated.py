"""The apparel of an animation: as it is, or simulated by the physics of its character's file."""

from __future__ import annotations

import logging
from collections.abc import Callable

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.simulate import simulate

__all__ = ["check_apparel", "simulated", "with_apparel"]

Progress = Callable[[str, float], None]
_log = logging.getLogger(__name__)


def check_apparel(character: Character) -> None:
    """Whether there is apparel to simulate.

    Raises:
        CharacterError: The file of the character says nothing of physics.
        FormatError: The nodes of the file are broken.
    """
    if apparel_rig(character) is None:
        raise CharacterError(
            f"{character.name}: nothing of this character is moved by physics; its file must be a PMX, PMD or VRM "
            "with rigid bodies or springs"
        )


def with_apparel(animation: Animation | RigAnimation, progress: Progress | None = None) -> RigAnimation:
    """The animation with its apparel simulated.

    Raises:
        CharacterError: There is no physics in its file, or it is moved by handles.
    """
    check_apparel(animation.character)
    if not isinstance(animation, RigAnimation):
        name = animation.character.name
        raise CharacterError(
            f"{name}: apparel is simulated on the bones of a humanoid's rig, and this one is moved by handles; try "
            "--onto rig"
        )
    return simulated(animation, progress)


def simulated(animation: RigAnimation, progress: Progress | None = None) -> RigAnimation:
    """The animation with its apparel simulated; what went wrong is logged.

    Raises:
        CharacterError: There is no physics in its file.
    """
    progress = progress or (lambda stage, done: None)
    progress("apparel", 0.0)
    found = simulate(animation, progress=lambda done: progress("apparel", done))
    for problem in found.report.problems():
        _log.warning("%s: %s", animation.character.name, problem)
    return found.animation
