"""Names of the body: SMPL's 22 joints, Bunraku's 30 handles, their groups, and what engines and avatars call them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.errors import OptionError

JOINT_NAMES: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
JOINT_PARENTS: tuple[int, ...] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
JOINT_COUNT = len(JOINT_NAMES)

HANDLE_NAMES: tuple[str, ...] = (
    *JOINT_NAMES, "left_fingers", "right_fingers", "head_top", "face", "left_wing", "right_wing", "tail", "tail_tip",
)  # fmt: skip
HANDLE_PARENTS: tuple[int, ...] = (*JOINT_PARENTS, 20, 21, 15, 15, 9, 9, 0, 28)
HANDLE_COUNT = len(HANDLE_NAMES)
HANDLE_INDEX = {name: index for index, name in enumerate(HANDLE_NAMES)}
"""Index of each handle, and of each joint, by its name."""
CHEST, HEAD = HANDLE_INDEX["spine3"], HANDLE_INDEX["head"]
WRISTS = (HANDLE_INDEX["left_wrist"], HANDLE_INDEX["right_wrist"])


def _mirror(names: tuple[str, ...]) -> tuple[int, ...]:
    swap = {"left": "right", "right": "left"}
    sides = [name.partition("_") for name in names]
    return tuple([names.index(swap.get(side, side) + gap + part) for side, gap, part in sides])


JOINT_MIRROR: tuple[int, ...] = _mirror(JOINT_NAMES)
HANDLE_MIRROR: tuple[int, ...] = _mirror(HANDLE_NAMES)


BESIDE = "beside"
"""Name of the joint of what stands still beside a body."""


def handle_names(played: np.ndarray) -> tuple[str, ...]:
    """Names of handles, by whose part each plays (`Handles.played`): those of the layout if there are 30, else numbers.
    A handle that plays the part of another is named after it and numbered: left_hip_2 is the second left hip.
    """
    count = len(played)
    if count != len(HANDLE_NAMES):
        return tuple(f"handle_{handle}" for handle in range(count))
    names, met = list(HANDLE_NAMES), [1] * count
    for handle, role in enumerate(played.tolist()):
        if role != handle:
            met[role] += 1
            names[handle] = f"{HANDLE_NAMES[role]}_{met[role]}"
    return tuple(names)


def sided(*parts: str) -> tuple[int, ...]:
    """Handles of these parts of the left side, and then of the right one."""
    return tuple([HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in parts])


def _named(*endings: str, side: str = "") -> tuple[int, ...]:
    return tuple([i for i, name in enumerate(HANDLE_NAMES) if name.startswith(side) and name.endswith(endings)])


_LEG = ("hip", "knee", "ankle", "foot")
_ARM = ("collar", "shoulder", "elbow", "wrist", "fingers")
_TORSO = ("spine1", "spine2", "spine3")
_HEAD = ("neck", "head", "head_top", "face")
PARTS: dict[str, tuple[int, ...]] = {
    "root": (0,),
    "legs": (0, *_named(*_LEG)),
    "left leg": (0, *_named(*_LEG, side="left")),
    "right leg": (0, *_named(*_LEG, side="right")),
    "arms": _named(*_ARM),
    "left arm": _named(*_ARM, side="left"),
    "right arm": _named(*_ARM, side="right"),
    "torso": _named(*_TORSO),
    "head": _named(*_HEAD),
    "upper body": (*_named(*_TORSO), *_named(*_HEAD), *_named(*_ARM), *_named("wing")),
    "lower body": (0, *_named(*_LEG), *_named("tail", "tail_tip")),
    "tail": _named("tail", "tail_tip"),
    "wings": _named("wing"),
}
"""Handles of each part. Legs come with the root: their steps stay in place only on its path."""


def kept_handles(keep: str | Sequence[str]) -> np.ndarray:
    """Which handles words name, shape (K,), bool: parts (`PARTS`) or single handles (`HANDLE_NAMES`), as a list or
    separated by commas; case, hyphens and underscores do not matter. OptionError if a word names nothing, or all words
    together name everything.
    """
    words = [word for entry in ([keep] if isinstance(keep, str) else keep) for word in entry.split(",")]
    out = np.zeros(HANDLE_COUNT, bool)
    for word in words:
        plain = " ".join(word.lower().replace("_", " ").replace("-", " ").split())
        if not plain and len(words) > 1:
            continue
        if plain in PARTS:
            out[list(PARTS[plain])] = True
        elif plain.replace(" ", "_") in HANDLE_INDEX:
            out[HANDLE_INDEX[plain.replace(" ", "_")]] = True
        else:
            parts = ", ".join(PARTS)
            raise OptionError(
                f"there is no part '{word.strip()}' to keep; there are {parts}, and handles like left_wrist"
            )
    if out.all():
        raise OptionError("all handles are kept, so there is nothing to generate; keep fewer")
    return out


REQUIRED = (
    "pelvis", "spine1", "head",
    *(f"{side}_{part}" for side in ("left", "right")
      for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")),
)  # fmt: skip
"""Handles that a humanoid must have."""

_MIDDLE = {
    "mixamo": {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck",
               "head": "Head", "head_top": "HeadTop_End"},
    "vrm": {"pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck",
            "head": "head"},
    "unreal": {"pelvis": "pelvis", "spine1": "spine_01", "spine2": "spine_02", "spine3": "spine_03",
               "neck": "neck_01", "head": "head"},
}  # fmt: skip
_SIDED = {
    "mixamo": {"collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "fingers": "HandMiddle1",
               "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase"},
    "vrm": {"collar": "Shoulder", "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand",
            "fingers": "MiddleProximal", "hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes"},
    "unreal": {"collar": "clavicle", "shoulder": "upperarm", "elbow": "lowerarm", "wrist": "hand",
               "fingers": "middle_01", "hip": "thigh", "knee": "calf", "ankle": "foot", "foot": "ball"},
}  # fmt: skip
_FORMS = {
    "mixamo": ("mixamorig:{part}", "mixamorig:Left{part}", "mixamorig:Right{part}"),
    "vrm": ("{part}", "left{part}", "right{part}"),
    "unreal": ("{part}", "{part}_l", "{part}_r"),
}
SKELETONS = tuple(_FORMS)
"""Skeletons whose names are known."""
ROOTS = {"unreal": "root"}
"""The joint above the pelvis, on the ground, of skeletons that have one."""


def engine_names(skeleton: str) -> tuple[str, ...]:
    """The name of each of the 30 handles in one of `SKELETONS`; parts that a humanoid lacks (wings, tail, face) keep
    their own.
    """
    middle, left, right = _FORMS[skeleton]
    out = []
    for name in HANDLE_NAMES:
        side, _, part = name.partition("_")
        if name in _MIDDLE[skeleton]:
            out.append(middle.format(part=_MIDDLE[skeleton][name]))
        elif side in ("left", "right") and part in _SIDED[skeleton]:
            out.append((left if side == "left" else right).format(part=_SIDED[skeleton][part]))
        else:
            out.append(name)
    return tuple(out)
