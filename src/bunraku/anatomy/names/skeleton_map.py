"""Which joint of a skeleton is which of SMPL's 22: by the words of many conventions, or else by structure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bunraku.anatomy.names.bone_names import handle_of_joints
from bunraku.anatomy.names.bone_words import plain_name
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.motion import Skeleton, line_up
from bunraku.errors import MotionError

_J = {name: index for index, name in enumerate(JOINT_NAMES)}


@dataclass(frozen=True)
class SkeletonMap:
    """Joints of a skeleton by SMPL's names."""

    joints: tuple[int, ...]  # index of the joint of each of SMPL's 22, -1 where there is none
    # what each was found by: "given", "name", "rig", "hierarchy" or "structure"; "" where there is none
    how: tuple[str, ...]
    convention: str = ""  # name of the program or data whose names these are, as far as that is plain; "" otherwise

    def of(self, name: str) -> int:
        """Index of the joint for one of SMPL's names, -1 for none."""
        return self.joints[_J[name]]

    @property
    def missing(self) -> tuple[str, ...]:
        """SMPL's names that no joint has."""
        return tuple(name for name, joint in zip(JOINT_NAMES, self.joints, strict=True) if joint < 0)


_MMD_CENTRES = ("センター", "グルーブ", "腰", "全ての親")
"""Bones that carry the whole body, the one that motions move first. The legs undo what 腰 turns."""

_MMD_MIDDLE = {"pelvis": ("下半身", "腰", "センター"), "spine1": ("上半身",), "neck": ("首",), "head": ("頭",)}
_MMD_SIDED = {
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

    found = {part: first(*options) for part, options in _MMD_MIDDLE.items()}
    for side, mark in (("left", "左"), ("right", "右")):
        found |= {
            f"{side}_{part}": first(*(mark + option for option in options)) for part, options in _MMD_SIDED.items()
        }
    found["spine3"] = first("上半身3", "上半身2")
    found["spine2"] = first("上半身2") if "上半身3" in number else -1
    if min(found[name] for name in _NEEDED) < 0:
        return None
    joints = [found[name] for name in JOINT_NAMES]
    how = tuple("name" if joint >= 0 else "" for joint in joints)
    return SkeletonMap(tuple(joints), how, "MikuMikuDance")


def mmd_centre(names: Sequence[str], parents: np.ndarray, known: SkeletonMap) -> int:
    """The bone of an MMD model that carries the whole body: travel is on it, so that what hangs beside the body comes
    along.
    """
    line = line_up(known.of("pelvis"), parents)
    named = {plain_name(names[bone]): bone for bone in line}
    return next((named[name] for name in _MMD_CENTRES if name in named), line[-1])


ALIKE = 0.15  # twins differ by less than this share in length
LONG = 0.3  # of the longest twins: what is shorter is not a limb
SHORT_BONE = 0.55  # a first bone shorter than this share of the next one is a collar bone, or joins a leg to the pelvis

# Chosen on rigs whose names were taken away (benchmarks/apparel_bones.py).
FARTHER = 1.5  # times as far as all others of three and more: what goes on a limb, with twists or sleeves beside it
LEVEL = 0.1  # of the same: twins that end as low as others do, or begin as high


def joints_by_structure(skeleton: Skeleton, mass: np.ndarray | None = None) -> dict[str, int]:
    """Joints by SMPL's names, as far as legs are found; without legs none.

    The body faces where its feet point in the rest pose, +Z where it has none.

    Args:
        skeleton: Each joint after its parent.
        mass: How much skin each joint holds, shape (J,): what holds none, as targets for the feet do, is not a limb.
    """
    count, parents, positions = len(skeleton.names), skeleton.parents, skeleton.positions
    children = [np.flatnonzero(parents == joint).tolist() for joint in range(count)]
    length = np.linalg.norm(skeleton.offsets, axis=-1)
    reach = np.zeros(count)  # length of the longest chain below, with the bone to it
    sizes = np.ones(count, int)
    held = np.ones(count) if mass is None else np.array(mass, float)
    for joint in range(count - 1, 0, -1):
        below = max((reach[child] + length[child] for child in children[joint]), default=0.0)
        reach[joint] = below
    for joint in range(count - 1, 0, -1):
        sizes[parents[joint]] += sizes[joint]
        held[parents[joint]] += held[joint]
    depth = np.zeros(count, int)
    for joint in range(1, count):
        depth[joint] = depth[parents[joint]] + 1

    def chain(joint: int) -> list[int]:
        out = [joint]
        while children[out[-1]]:
            after = sorted(children[out[-1]], key=lambda child: -(reach[child] + length[child]))
            whole = [reach[child] + length[child] for child in after]
            if len(after) > 2 and whole[0] < FARTHER * whole[1]:  # fingers
                break
            out.append(after[0])
        return out

    def top_of(joint: int) -> float:
        """How high what hangs on a joint reaches."""
        out, queue = -np.inf, [joint]
        while queue:
            one = queue.pop()
            out = max(out, float(positions[one, 1]))
            queue += children[one]
        return out

    twins, least = [], 3 if mass is None else 2  # the last bones of rigs have lengths that are not seen
    for joint in range(count):
        for a, b in combinations([child for child in children[joint] if held[child] > 0], 2):
            far = min(reach[a], reach[b])
            if far > 0 and abs(reach[a] - reach[b]) < ALIKE * far and len(chain(a)) == len(chain(b)) >= least:
                twins.append((joint, a, b))
    longest = max((reach[a] for _, a, _ in twins), default=0.0)  # one long plait must not make the arms look short
    pairs = [pair for pair in twins if min(reach[pair[1]], reach[pair[2]]) > LONG * longest]
    if not pairs:
        return {}
    level = LEVEL * longest

    def low(pair: tuple[int, int, int]) -> float:
        return float(positions[[chain(first)[-1] for first in pair[1:]], 1].mean())

    ground = min(low(pair) for pair in pairs)
    legs = min(pairs, key=lambda pair: (low(pair) > ground + level, depth[pair[0]], low(pair)))
    others = [pair for pair in pairs
              if not {pair[1], pair[2]} & {legs[1], legs[2]} and not _within(pair[0], legs[1:], parents)]  # fmt: skip
    hips = float(positions[list(legs[1:]), 1].mean())

    def reaches(pair: tuple[int, int, int]) -> tuple[bool, float]:
        """Whether twins end in hands, and how far apart they end over their length: arms reach to the sides, where
        hair, skirts and capes hang down.
        """
        ends = [chain(first)[-1] for first in pair[1:]]
        hands = all(len(children[end]) > 2 for end in ends)
        gap = positions[ends[0]] - positions[ends[1]] - (positions[pair[1]] - positions[pair[2]])
        return hands, float(np.hypot(gap[0], gap[2])) / (reach[pair[1]] + reach[pair[2]])

    # what hangs about the hips as a skirt does is not an arm where there are others
    higher = [pair for pair in others if positions[list(pair[1:]), 1].mean() > hips + level]
    arms = max(higher or others, key=reaches, default=None)
    out = {"pelvis": legs[0]}
    lines = [chain(joint) for joint in legs[1:]]
    if len(lines[0]) >= 4 and length[lines[0][1]] < SHORT_BONE * length[lines[0][2]]:
        lines = [line[1:] for line in lines]
    toes = np.zeros(3)
    if len(lines[0]) > 3:
        toes = np.sum([positions[line[3]] - positions[line[2]] for line in lines if len(line) > 3], axis=0)
    forward = np.array([toes[0], 0, toes[2]]) if np.hypot(toes[0], toes[2]) > 1e-6 else np.array([0.0, 0, 1])
    left = np.cross([0, 1, 0], forward)
    for line, side in zip(lines, _sides(lines, positions, left), strict=True):
        out |= {f"{side}_{part}": joint for part, joint in zip(("hip", "knee", "ankle", "foot"), line, strict=False)}
    if arms is not None:
        lines = [chain(joint) for joint in arms[1:]]
        short = len(lines[0]) == 3 and length[lines[0][1]] < SHORT_BONE * length[lines[0][2]]
        collared = len(lines[0]) >= 4 or short
        parts = ("collar", "shoulder", "elbow", "wrist")[0 if collared else 1 :]
        for line, side in zip(lines, _sides(lines, positions, left), strict=True):
            out |= {f"{side}_{part}": joint for part, joint in zip(parts, line, strict=False)}
        upper = [child for child in children[arms[0]] if child not in arms[1:]]
        if upper:
            line = chain(max(upper, key=lambda child: (top_of(child), sizes[child])))
            out |= {"neck": line[0], "head": line[1]} if len(line) > 1 else {"head": line[0]}
    return out


def _within(joint: int, roots: tuple[int, ...], parents: np.ndarray) -> bool:
    while joint >= 0:
        if joint in roots:
            return True
        joint = int(parents[joint])
    return False


def _sides(lines: list[list[int]], positions: np.ndarray, left: np.ndarray) -> tuple[str, str]:
    across = [float(positions[line].mean(axis=0) @ left) for line in lines]
    return ("left", "right") if across[0] >= across[1] else ("right", "left")


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
    """The joints of a skeleton that play SMPL's parts. MotionError if a given name is unknown, or no pelvis and legs
    are found.

    Args:
        skeleton: Any, of something with a pelvis and two legs.
        names: Joints to take whatever the rules say: the skeleton's name by SMPL's; "" for none.
    """
    if not names:
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
                f"'{wrong}' in the map of names is not a joint; there are "
                f"{', '.join(JOINT_NAMES if name not in _J else skeleton.names)}"
            )
        joints[_J[name]], how[_J[name]] = (skeleton.names.index(own) if own else -1), "given"
    for name, joint in _by_words(skeleton.names).items():
        take(name, joint, "name")
    handles = handle_of_joints(skeleton.names, parents, skeleton.positions)
    for index, name in enumerate(JOINT_NAMES):
        if not name.startswith("spine"):
            candidates: list[int] = np.flatnonzero(handles == index).tolist()
            take(name, next((joint for joint in candidates if _fits(joint, index, joints, parents)), -1), "rig")
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
    taken = leg_lines | set(joints.tolist())
    spine = [joint for joint in reversed(line_up(chest, parents)) if joint not in taken] if chest >= 0 else []
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
