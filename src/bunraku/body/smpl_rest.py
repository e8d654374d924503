"""The T-pose that SMPL's rotations are relative to, and how it differs from the reference body's.

SMPL's mean body stands with its legs a few degrees apart and its arms a little behind, the reference body with straight
ones.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.geometry.rotations import rotation_between

__all__ = ["LIMB_CHILD", "smpl_offsets", "smpl_rotations"]

# Centimetres from the parent joint, both sides averaged: enough for directions.
_LEFT_AND_MIDDLE = {
    "left_hip": (6.5, -9, -1), "spine1": (0, 12, -3.5), "left_knee": (3.5, -37.5, -0.4), "spine2": (0, 13.6, 2.2),
    "left_ankle": (-1.4, -39.8, -4.4), "spine3": (0, 5.5, 0.3), "left_foot": (3.5, -6, 12.2), "neck": (0, 21.3, -3.4),
    "left_collar": (7.7, 11.4, -2.1), "head": (0, 8.9, 5), "left_shoulder": (11.5, 4.5, -1.9), "left_elbow": (25.5,
    -1.5, -2.3),
    "left_wrist": (26.5, 1.3, -0.7),
}  # fmt: skip

_ENDS = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
LIMB_CHILD: dict[int, int] = {
    JOINT_NAMES.index(f"{side}_{part}"): JOINT_NAMES.index(f"{side}_{end}")
    for part, end in _ENDS.items()
    for side in ("left", "right")
}
"""The joint at the end of each limb, by the limb's joint: parts whose direction is what a pose is about."""


@lru_cache(maxsize=1)
def smpl_offsets() -> np.ndarray:
    """Offset of each joint of SMPL's mean body from its parent's, to about a centimetre [m], shape (22, 3); zero for
    the pelvis.
    """
    out = np.zeros((JOINT_COUNT, 3))
    for name, offset in _LEFT_AND_MIDDLE.items():
        out[JOINT_NAMES.index(name)] = np.array(offset) / 100
        if name.startswith("left"):
            out[JOINT_NAMES.index(name.replace("left", "right"))] = np.array(offset) / 100 * [-1, 1, 1]
    return out


@lru_cache(maxsize=1)
def smpl_rotations() -> np.ndarray:
    """World rotation of each part that turns the reference body's T-pose into SMPL's, shape (22, 3, 3).

    Limbs are turned, and hands with their forearms; the trunk and the feet face the same way in both.
    """
    own, want = reference_body().skeleton.offsets.astype(float), smpl_offsets()
    out = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint, child in LIMB_CHILD.items():
        above = out[JOINT_PARENTS[joint]]
        out[joint] = rotation_between(above @ own[child], want[child]) @ above
    for side in ("left", "right"):
        out[JOINT_NAMES.index(f"{side}_wrist")] = out[JOINT_NAMES.index(f"{side}_elbow")]
    return out
