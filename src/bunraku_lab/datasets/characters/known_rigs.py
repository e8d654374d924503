"""What is known of rigs beyond their bone names: which way they face, where their root is, and the rigs whose names say
nothing.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.geometry.rotations import matrix_y
from bunraku.skeletons.bone_words import left_axis

__all__ = ["facing_turn", "known_handles", "root_joint"]

# Rigs whose bones have no names, or wrong ones: the turn about +Y that makes them face +Z [degrees], and the part of
# each bone.
# Sides follow from where the bone stands.
_PET = "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.014:shoulder Bone.015:elbow Bone.016:wrist " \
    "Bone.017:shoulder Bone.018:elbow Bone.019:wrist Bone.004:tail Bone.005:tail Bone.006:tail_tip Bone.007:tail_tip " \
    "Bone.008:hip Bone.009:knee Bone.010:ankle Bone.011:hip Bone.012:knee Bone.013:ankle"  # fmt: skip
_BY_HAND: dict[str, tuple[float, str]] = {
    "quaternius2019/Cat": (-90, _PET),
    "quaternius2019/Dog": (-90, _PET),
    "quaternius2019/Wolf": (-90, _PET),
    "quaternius2019/Chick": (-90, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.009:head Bone.003:hip Bone.004:knee "
                                  "Bone.005:ankle Bone.006:hip "
                             "Bone.007:knee Bone.008:ankle"),
    "quaternius2019/bird": (0, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:pelvis Bone.004:tail "
                               "Bone.005:tail_tip Bone.006:wing "
                            "Bone.007:wing Bone.008:wing Bone.009:wing"),
    "quaternius2019/Eagle": (180, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.007:wing "
                                  "Bone.008:wing Bone.009:wing Bone.010:wing "
                             "Bone.011:wing Bone.012:wing Bone.013:wing Bone.014:wing Bone.015:wing Bone.004:tail "
                             "Bone.005:tail Bone.006:tail_tip "
                             "Bone.016:hip Bone.017:knee Bone.018:ankle Bone.019:foot Bone.020:hip Bone.021:knee "
                             "Bone.022:ankle Bone.023:foot"),
    "quaternius2019/Fish": (0, "Bone:pelvis Bone.001:head Bone.002:tail Bone.003:shoulder Bone.004:elbow "
                               "Bone.005:shoulder Bone.006:elbow"),
    "quaternius2019/Whale": (0, "Bone:pelvis Bone.002:spine2 Bone.009:head Bone.005:shoulder Bone.006:elbow "
                                "Bone.007:shoulder Bone.008:elbow "
                             "Bone.003:tail Bone.004:tail_tip"),
    "quaternius2019/Red_Fox": (180, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:tail Bone.010:tail_tip "
                                    "Bone.004:hip Bone.005:knee "
                               "Bone.006:ankle Bone.007:hip Bone.008:knee Bone.009:ankle Bone.011:shoulder "
                               "Bone.012:elbow Bone.013:wrist "
                               "Bone.014:shoulder Bone.015:elbow Bone.016:wrist"),
    "quaternius2019/Piranha": (0, "Bone:pelvis Bone.001:spine2 Bone.002:spine3 Bone.003:head Bone.004:face "
                                  "Bone.007:shoulder Bone.008:shoulder "
                               "Bone.005:tail Bone.006:tail_tip"),
    "quaternius2019/Skeleton": (0, "Hips:pelvis Torso:spine2 Neck:neck Head:head L.UpperLeg:hip L.DownLeg:knee "
                                   "R.UpperLeg:hip R.DownLeg:knee "
                                "L.UpperLeg.001:shoulder L.DownLeg.001:elbow R.UpperLeg.001:shoulder "
                                "R.DownLeg.001:elbow"),
    "quaternius2019/Bat": (0, "Bone:face"),
    "quaternius2019/Dragon": (0, "Bone:face"),
}  # fmt: skip


def facing_turn(name: str, names: tuple[str, ...], positions: np.ndarray) -> np.ndarray:
    """The quarter turn about +Y after which the character faces +Z, shape (3, 3)."""
    if name in _BY_HAND:
        return np.asarray(matrix_y(np.array(np.radians(_BY_HAND[name][0]))))
    left = left_axis(names, positions)
    if left is None or left[0] > 0.5:  # a stride or a twist is not a turn
        return np.eye(3)
    quarter = np.round(np.arctan2(left[2], left[0]) / (np.pi / 2))
    return np.asarray(matrix_y(np.array(quarter * np.pi / 2)))


def known_handles(name: str, names: tuple[str, ...], positions: np.ndarray, handles: np.ndarray) -> np.ndarray:
    """The handle of each joint, shape (J,): those found by name, but for rigs whose names say nothing, which are listed
    here.

    Args:
        name: Path of the character in its archive, without the suffix.
        names: Joint names, length J.
        positions: Joint positions, facing +Z, shape (J, 3).
        handles: What the names gave, shape (J,).
    """
    if name not in _BY_HAND:
        return handles
    parts = dict(entry.rsplit(":", 1) for entry in _BY_HAND[name][1].split())
    handles = handles.copy()
    middle = (positions[:, 0].max() + positions[:, 0].min()) / 2
    for joint, bone in enumerate(names):
        part = parts.get(bone)
        if part:
            side = "left_" if positions[joint, 0] > middle else "right_"
            handles[joint] = HANDLE_NAMES.index(part if part in HANDLE_NAMES else side + part)
    return handles


def root_joint(
    vertices: np.ndarray, joints: np.ndarray, parents: np.ndarray, handles: np.ndarray, mass: np.ndarray
) -> np.ndarray:
    """The root joint b_1 of Eq. 4, shape (3,): the mean of the pelvis joints that move something, or of the pelvis, or
    of the roots.

    Args:
        vertices: Of the mesh, in the frame and unit of the joints, shape (V, 3); the root is kept inside their box.
        joints, parents, handles, mass: Position, parent, handle and total skin weight of each joint, J rows.
    """
    for choice in ((handles == 0) & (mass > 0), handles == 0, parents < 0):
        if choice.any():
            position = joints[choice].mean(axis=0)
            return np.asarray(np.clip(position, vertices.min(axis=0), vertices.max(axis=0)), np.float32)
    return np.zeros(3, np.float32)
