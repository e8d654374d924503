"""Whether a clip walks on the spot, as clips of games do whose engine moves the character: its standing feet slide all
the time.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bunraku.anatomy.joints import reference_joints
from bunraku.anatomy.legs import Leg, find_legs
from bunraku.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.feet import find_contacts

__all__ = ["is_treadmill"]

# mean speed of standing feet from which on they slide on purpose [m/s]; captured clips drift by less than a third of
# this
SLIDES = 0.25
TRAVELS = 0.5  # who goes this share of what its feet slide does not stay on the spot


def is_treadmill(motion: HandleMotion) -> bool:
    """Whether the reference body's feet slide under it in a motion that goes nowhere.

    Args:
        motion: Of the reference body, N frames.
    """
    if len(motion) < 8:
        return False
    character, legs = _standing()
    missing = find_contacts(motion, character, reference_body().handles, legs, float(character.vertices[:, 1].min()))[1]
    slide = float(np.linalg.norm(missing, axis=1).mean() * motion.fps)
    path = np.diff(motion.root_translation[:, [0, 2]], axis=0)
    speed = float(np.linalg.norm(path, axis=1).mean() * motion.fps)
    return slide > SLIDES and speed < TRAVELS * slide


@lru_cache(maxsize=1)
def _standing() -> tuple[Character, list[Leg]]:
    body = reference_body()
    character = Character("reference", body.vertices, body.faces)
    return character, find_legs(character, body.handles, reference_joints())
