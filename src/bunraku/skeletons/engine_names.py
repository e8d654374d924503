"""The names that game engines and avatars give the joints of a humanoid, by the 30 handles.

Required joints and their parents are those of Unity's Humanoid (`HumanTrait.RequiredBone`) and of VRM 1.0
(VRMC_vrm.humanoid), which ask for the same fifteen.
"""

from __future__ import annotations

from bunraku.body.layout import HANDLE_NAMES

__all__ = ["REQUIRED", "SKELETONS", "ROOTS", "engine_names"]

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
"""Whose names there are."""
ROOTS = {"unreal": "root"}
"""The joint above the pelvis, on the ground, where a skeleton has one."""


def engine_names(skeleton: str) -> tuple[str, ...]:
    """The name of each of the 30 handles; parts that a humanoid lacks (wings, tail, face) keep their own.

    Args:
        skeleton: One of `SKELETONS`.
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
