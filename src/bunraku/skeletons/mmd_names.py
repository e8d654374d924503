"""Which bones of MikuMikuDance's standard skeleton are which of SMPL's 22 joints.

Its trunk begins twice: `下半身`, the pelvis with the legs, and `上半身`, the spine, both hang on the same bone at
the waist. So no rule that asks for parts below parts finds them; their names are the same in all models.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.skeletons.bone_words import plain_name
from bunraku.skeletons.joint_map import SkeletonMap

__all__ = ["MMD_CENTRES", "mmd_skeleton_map"]

MMD_CENTRES = ("センター", "腰", "グルーブ", "全ての親")
"""Bones that carry the whole body, the one that motions move first."""

_MIDDLE = {"pelvis": ("下半身", "腰", "センター"), "spine1": ("上半身",), "neck": ("首",), "head": ("頭",)}
_SIDED = {
    "collar": ("肩",), "shoulder": ("腕",), "elbow": ("ひじ",), "wrist": ("手首",), "hip": ("足",), "knee": ("ひざ",),
    "ankle": ("足首",),
    "foot": ("足先EX", "つま先EX", "つま先"),
}  # fmt: skip
_NEEDED = ("pelvis", "left_hip", "right_hip", "left_knee", "right_knee")


def mmd_skeleton_map(names: Sequence[str]) -> SkeletonMap | None:
    """The joints of a skeleton whose bones have MMD's standard names, or None where they do not.

    Args:
        names: Names of all bones.
    """
    number: dict[str, int] = {}
    for index, name in enumerate(names):
        number.setdefault(plain_name(name), index)

    def first(*options: str) -> int:
        return next((number[option] for option in options if option in number), -1)

    found = {part: first(*options) for part, options in _MIDDLE.items()}
    for side, mark in (("left", "左"), ("right", "右")):
        found |= {f"{side}_{part}": first(*(mark + option for option in options)) for part, options in _SIDED.items()}
    found["spine3"] = first("上半身3", "上半身2")
    found["spine2"] = first("上半身2") if "上半身3" in number else -1
    if min(found[name] for name in _NEEDED) < 0:
        return None
    joints = np.array([found[name] for name in JOINT_NAMES])
    return SkeletonMap(
        tuple(int(joint) for joint in joints), tuple("name" if joint >= 0 else "" for joint in joints), "MikuMikuDance"
    )
