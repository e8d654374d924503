"""Limbs of captured motion that are rolled by half a turn: the knee seems to bend forwards, and skin twists around it.

Joint positions of such clips are right and only the roll of the bones is not, so the rotations are found again from the
positions.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.from_positions import motion_from_positions
from bunraku.body.layout import JOINT_NAMES
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import axis_angle_from_matrix

__all__ = ["rolled_limbs", "unrolled"]

HINGES = {"left_knee": (1, 0, 0), "right_knee": (1, 0, 0), "left_elbow": (0, -1, 0), "right_elbow": (0, 1, 0)}
"""Axis about which each bends in the T-pose, roughly."""
BENT = np.deg2rad(20)
FEWEST = 8  # frames


def rolled_limbs(motion: SkeletalMotion) -> list[str]:
    """Hinges that bend the wrong way in most of the frames in which they are bent by 20 degrees or more.

    Args:
        motion: Of SMPL's 22 joints, rest in the T-pose.
    """
    found = []
    for name, axis in HINGES.items():
        turn = axis_angle_from_matrix(motion.rotations[:, JOINT_NAMES.index(name)].astype(np.float64))
        angle = np.linalg.norm(turn, axis=1)
        bent = angle > BENT
        if bent.sum() >= FEWEST and float(np.median(turn[bent] @ np.array(axis) / angle[bent])) < -0.5:
            found.append(name)
    return found


def unrolled(motion: SkeletalMotion) -> SkeletalMotion:
    """The motion with its rotations found again from its joint positions, where a limb is rolled; else as it is."""
    if not rolled_limbs(motion):
        return motion
    return motion_from_positions(motion.world()[1], motion.fps)
