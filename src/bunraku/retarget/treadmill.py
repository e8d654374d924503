"""Whether a clip walks on the spot, as clips of games do whose engine moves the character: its standing feet slide all
the time.
"""

from __future__ import annotations

import numpy as np

from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.feet import Feet

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
    missing = Feet().contacts(motion, reference_anatomy())[1]
    slide = float(np.linalg.norm(missing, axis=1).mean() * motion.fps)
    path = np.diff(motion.root_translation[:, [0, 2]], axis=0)
    speed = float(np.linalg.norm(path, axis=1).mean() * motion.fps)
    return slide > SLIDES and speed < TRAVELS * slide
