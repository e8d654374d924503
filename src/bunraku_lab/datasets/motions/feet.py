"""The constant slope of the feet that some captured subjects have, measured and taken out.

The feet of some subjects were marked so that they slope by 11 to 30 degrees while flat on the floor. The slope is a
constant of the subject, so the median over its standing feet is it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.datasets.motions.sources import subject_of

__all__ = ["level_feet", "standing_foot_pitch", "subject_pitches"]

ANKLES = (JOINT_NAMES.index("left_ankle"), JOINT_NAMES.index("right_ankle"))
LEAST, MOST = np.radians(2.0), np.radians(35.0)


def standing_foot_pitch(motion: SkeletalMotion) -> float:
    """Median slope [rad] of the feet while they stand (low and slower than 0.3 m/s); up is positive, NaN where they
    never stand.
    """
    rotations, positions = motion.world()
    slopes = []
    for joint in ANKLES:
        height = positions[:, joint, 1]
        speed = np.linalg.norm(np.diff(positions[:, joint], axis=0, prepend=positions[:1, joint]), axis=-1) * motion.fps
        stands = (height < np.quantile(height, 0.3) + 0.03) & (speed < 0.3)
        if stands.sum() >= 8:
            slopes.append(float(np.median(np.arcsin(np.clip(rotations[stands, joint, 1, 2], -1, 1)))))
    return float(np.mean(slopes)) if slopes else float("nan")


def subject_pitches(pitches: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Slope of each subject [rad] from (clip name, slope) pairs: the median of its clips, 0 where that is small, wild
    or of few clips.
    """
    groups = defaultdict(list)
    for name, pitch in pitches:
        if np.isfinite(pitch):
            groups[subject_of(name)].append(pitch)
    medians = {subject: float(np.median(values)) for subject, values in groups.items() if len(values) >= 3}
    return {subject: value if LEAST < abs(value) < MOST else 0.0 for subject, value in medians.items()}


def level_feet(motion: SkeletalMotion, name: str, slopes: Mapping[str, float]) -> SkeletalMotion:
    """The motion with its subject's constant slope taken out of both ankles."""
    slope = slopes.get(subject_of(name), 0.0)
    if slope == 0.0:
        return motion
    rotations = motion.rotations.copy()
    turn = matrix_from_axis_angle(np.array([slope, 0.0, 0.0])).astype(np.float32)
    for joint in ANKLES:
        rotations[:, joint] = rotations[:, joint] @ turn
    return replace(motion, rotations=rotations)
