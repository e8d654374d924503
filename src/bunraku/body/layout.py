"""The words for body parts: SMPL's 22 joints and Bunraku's 30 handles.

The first 22 handles are the parts that SMPL's 22 joints move, so handle 7 of any character means what it means on the
reference body. The other eight are parts that many characters have and people lack or share with a neighbour: fingers,
what stands on the head (hair, hats, horns, ears), the front of the face (snout, beak, jaw), two wings (on a person the
two halves of the upper back, on a character with a cape the cape) and a tail of two pieces.
"""

from __future__ import annotations

from bunraku.core.character import Handles

__all__ = [
    "HANDLE_COUNT",
    "HANDLE_MIRROR",
    "HANDLE_NAMES",
    "HANDLE_PARENTS",
    "JOINT_COUNT",
    "JOINT_MIRROR",
    "JOINT_NAMES",
    "JOINT_PARENTS",
    "handle_names",
]


JOINT_NAMES: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3",
    "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder",
    "left_elbow",
    "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
JOINT_PARENTS: tuple[int, ...] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
JOINT_COUNT = len(JOINT_NAMES)

HANDLE_NAMES: tuple[str, ...] = (
    *JOINT_NAMES, "left_fingers", "right_fingers", "head_top", "face", "left_wing", "right_wing", "tail", "tail_tip",
)  # fmt: skip
HANDLE_PARENTS: tuple[int, ...] = (*JOINT_PARENTS, 20, 21, 15, 15, 9, 9, 0, 28)
HANDLE_COUNT = len(HANDLE_NAMES)


def _mirror(names: tuple[str, ...]) -> tuple[int, ...]:
    swap = {"left": "right", "right": "left"}
    sides = [name.partition("_") for name in names]
    return tuple([names.index(swap.get(side, side) + gap + part) for side, gap, part in sides])


JOINT_MIRROR: tuple[int, ...] = _mirror(JOINT_NAMES)
HANDLE_MIRROR: tuple[int, ...] = _mirror(HANDLE_NAMES)


def handle_names(handles: Handles) -> tuple[str, ...]:
    """Names of handles: those of the layout where there are as many, numbers otherwise.

    A handle that plays the part of another is named after it and numbered: left_hip_2 is the second left hip.
    """
    count = len(handles.positions)
    if count != len(HANDLE_NAMES):
        return tuple(f"handle_{handle}" for handle in range(count))
    names, met = list(HANDLE_NAMES), [1] * count
    for handle, role in enumerate(handles.played.tolist()):
        if role != handle:
            met[role] += 1
            names[handle] = f"{HANDLE_NAMES[role]}_{met[role]}"
    return tuple(names)
