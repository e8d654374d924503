"""Where palms are, by forward kinematics: 9 cm from the wrist along the hand."""

import numpy as np

from bunraku.gestures.play import AT


def palms(motion):
    """Both palms: to the left of the body, over the ground, ahead [m], shape (N, 2, 3)."""
    rotations, positions = motion.world()
    sides = (("left", 1), ("right", -1))
    return np.stack(
        [
            positions[:, AT[f"{side}_wrist"]] + 0.09 * sign * rotations[:, AT[f"{side}_wrist"]][:, :, 0]
            for side, sign in sides
        ],
        axis=1,
    )
