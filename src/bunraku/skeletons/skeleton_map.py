"""Which joint of a skeleton is which of SMPL's 22: by the words of many conventions first, by structure where names say
nothing.

Arms, legs, neck and head have names in every convention; spines have from one bone to five with names that contradict
each other, so the trunk is read off the hierarchy: its first bone is `spine1`, the one that the arms hang on is
`spine3`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.motion import Skeleton, line_up
from bunraku.errors import MotionError
from bunraku.skeletons.bone_names import handle_of_joints
from bunraku.skeletons.joint_map import _J, SkeletonMap
from bunraku.skeletons.skeleton_structure import joints_by_structure

__all__ = ["map_skeleton"]

_NEEDED = ("pelvis", "left_hip", "right_hip", "left_knee", "right_knee")

# What the words of a name mean once its side and prefix are off; earlier words are taken before later ones.
_MIDDLE = {"pelvis": ("hips", "pelvis", "hip", "hipscenter"), "neck": ("neck",), "head": ("head",)}
_SIDED = {
    "collar": ("collar", "clavicle", "clav"),
    "shoulder": ("arm", "upperarm", "uparm", "shldr", "humerus"),
    "elbow": ("forearm", "lowerarm", "lowarm", "elbow", "radius"),
    "wrist": ("hand", "wrist"),
    "hip": ("upleg", "upperleg", "thigh", "femur", "hip"),
    "knee": ("leg", "lowerleg", "lowleg", "shin", "calf", "tibia", "knee"),
    "ankle": ("ankle", "foot"),
    "foot": ("toe", "toes", "toebase", "toe0", "ball"),
}
_PREFIX = re.compile(
    r"^(mixamorig\d*|bip\d*|j_?bip(_c)?|cc_?base|valvebiped|character\d+|def|org|rig|skel|bn|b|[mf]_avg|avg)[ _.:\-]+",
    re.IGNORECASE,
)
_CONVENTIONS: tuple[tuple[str, str], ...] = (
    ("Mixamo", r"^mixamorig"),
    ("SMPL", r"^(left_hip|l_?hip)$.*^(left_collar|l_?collar)$"),
    ("CMU", r"^LHipJoint$"),
    ("Daz", r"^[lr]Shldr$"),
    ("Bandai-Namco", r"^joint_Root$|^UpperLeg_L$.*^Toes_L$|^Toes_L$.*^UpperLeg_L$"),
    ("Rokoko", r"^LeftThigh$.*^LeftShin$"),
    ("Biped", r"^Bip\d+"),
    ("VRM", r"^J_Bip_|^leftUpperLeg$"),
    ("Poser", r"^LeftCollar$.*^LeftElbow$|^LeftHip$.*^LeftKnee$"),
    ("MotionBuilder", r"^LeftUpLeg$.*^LeftArm$|^LeftArm$.*^LeftUpLeg$|^Left_?UpLeg$"),
)


def map_skeleton(skeleton: Skeleton, names: Mapping[str, str] | None = None) -> SkeletonMap:
    """The joints of a skeleton that play SMPL's parts.

    Args:
        skeleton: Any, of something with a pelvis and two legs.
        names: Joints to take whatever the rules say: the skeleton's name by SMPL's; "" for none.

    Raises:
        MotionError: A given name is unknown, or no pelvis and legs are found.
    """
    if not names:
        from bunraku.skeletons.mmd_names import mmd_skeleton_map

        standard = mmd_skeleton_map(skeleton.names)
        if standard is not None:
            return standard
    parents = [int(parent) for parent in skeleton.parents]
    joints, how = np.full(JOINT_COUNT, -1), [""] * JOINT_COUNT

    def take(name: str, joint: int, reason: str) -> None:
        index = _J[name]
        if not how[index] and joint >= 0 and joint not in joints:
            joints[index], how[index] = joint, reason

    for name, own in (names or {}).items():
        if name not in _J or (own and own not in skeleton.names):
            wrong = name if name not in _J else own
            raise MotionError(
                f"'{wrong}' in the map of names is no joint; there are "
                f"{', '.join(JOINT_NAMES if name not in _J else skeleton.names)}"
            )
        joints[_J[name]], how[_J[name]] = (skeleton.names.index(own) if own else -1), "given"
    for name, joint in _by_words(skeleton.names).items():
        take(name, joint, "name")
    handles = handle_of_joints(skeleton.names, parents, skeleton.positions)
    for index, name in enumerate(JOINT_NAMES):
        if not name.startswith("spine"):
            take(
                name,
                next(
                    (
                        int(joint)
                        for joint in np.flatnonzero(handles == index)
                        if _fits(int(joint), index, joints, parents)
                    ),
                    -1,
                ),
                "rig",
            )
    if min(joints[_J[name]] for name in _NEEDED) < 0:
        for name, joint in joints_by_structure(skeleton).items():
            take(name, joint, "structure")
    for name, joint in _trunk(joints, parents).items():
        take(name, joint, "hierarchy")
    lacking = [name for name in _NEEDED if joints[_J[name]] < 0]
    if lacking:
        raise MotionError(
            f"no joint of this skeleton is known to be its {', '.join(lacking)}; name them in a map of names"
        )
    return SkeletonMap(tuple(int(joint) for joint in joints), tuple(how), _convention(skeleton.names))


def _convention(names: tuple[str, ...]) -> str:
    lines = "\n".join(names)
    return next((title for title, sign in _CONVENTIONS if re.search(sign, lines, re.MULTILINE | re.DOTALL)), "")


def _plain(name: str) -> tuple[str, int]:
    """A name without prefix and side in lower case, and the side: +1 left, -1 right, 0 none."""
    plain = _PREFIX.sub("", name.split(":")[-1].split("|")[-1]) or name
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", plain)]
    side = 0
    for word in list(words):
        if not side and word in ("l", "left", "r", "right"):
            side = 1 if word in ("l", "left") else -1
            words.remove(word)
    joined = "".join(words)
    match = re.match(r"^(left|right)(.+)$", joined)
    return (match[2], 1 if match[1] == "left" else -1) if match and not side else (joined, side)


def _by_words(names: tuple[str, ...]) -> dict[str, int]:
    """Joints whose names are words of a convention, by SMPL's names."""
    found: dict[tuple[str, int], int] = {}
    for joint, name in enumerate(names):
        found.setdefault(_plain(name), joint)
    out = {}
    for part, words in _MIDDLE.items():
        out[part] = next((found[word, 0] for word in words if (word, 0) in found), -1)
    for side, title in ((1, "left"), (-1, "right")):
        own = {
            part: next((found[word, side] for word in words if (word, side) in found), -1)
            for part, words in _SIDED.items()
        }
        extra = found.get(("shoulder", side), -1)  # a collar bone where there is an arm beside it
        if own["collar"] < 0 <= own["shoulder"]:
            own["collar"] = extra
        elif own["shoulder"] < 0:
            own["shoulder"] = extra
        if own["foot"] < 0 and ("ankle", side) in found:
            own["foot"] = found.get(("foot", side), -1)
        out |= {f"{title}_{part}": joint for part, joint in own.items()}
    return {name: joint for name, joint in out.items() if joint >= 0}


def _fits(joint: int, index: int, joints: np.ndarray, parents: list[int]) -> bool:
    """Whether a joint is below those that are above it in SMPL and above those that are below it."""
    line = line_up(joint, parents)
    if any(joints[above] >= 0 and joints[above] not in line for above in line_up(index, JOINT_PARENTS)[1:]):
        return False
    lower = [some for some in range(JOINT_COUNT) if joints[some] >= 0 and index in line_up(some, JOINT_PARENTS)[1:]]
    return all(joint in line_up(int(joints[some]), parents)[1:] for some in lower)


def _trunk(joints: np.ndarray, parents: list[int]) -> dict[str, int]:
    """Pelvis and spine by the hierarchy: from where the legs meet to where the arms, or neck and head, leave."""
    legs = [int(joints[_J[f"{side}_hip"]]) for side in ("left", "right")]
    arms = [next((int(joints[_J[f"{side}_{part}"]]) for part in ("collar", "shoulder",
    "elbow") if joints[_J[f"{side}_{part}"]] >= 0), -1)
            for side in ("left", "right")]  # fmt: skip
    out = {}
    if min(legs) >= 0 and joints[0] < 0:
        below = set(line_up(legs[0], parents)[1:])
        out["pelvis"] = next((joint for joint in line_up(legs[1], parents)[1:] if joint in below), -1)
    pelvis = int(joints[0]) if joints[0] >= 0 else out.get("pelvis", -1)
    top = [joint for joint in (*arms, int(joints[_J["neck"]]), int(joints[_J["head"]])) if joint >= 0]
    if pelvis < 0 or not top:
        return out
    lines = [line_up(joint, parents)[1:] for joint in (top if min(arms) < 0 else arms)]
    chest = next((joint for joint in lines[0] if all(joint in line for line in lines)), -1)
    leg_lines = {joint for leg in legs if leg >= 0 for joint in line_up(leg, parents)}
    spine = (
        [joint for joint in reversed(line_up(chest, parents)) if joint not in leg_lines and joint not in joints]
        if chest >= 0
        else []
    )
    if spine:
        out["spine3"] = spine[-1]
        if len(spine) > 1:
            out["spine1"] = spine[0]
        if len(spine) > 2:
            out["spine2"] = spine[(len(spine) - 1) // 2]
    if joints[_J["head"]] < 0 <= joints[_J["neck"]]:
        neck = int(joints[_J["neck"]])
        out["head"] = next((joint for joint, parent in enumerate(parents) if parent == neck), -1)
    return out
