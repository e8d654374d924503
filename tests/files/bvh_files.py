"""BVH files in the dialects of the programs and archives that write them, line by line, from a motion of SMPL's joints.

A dialect names the joints, hangs them on one another, and has a rest pose, an order of channels, a unit and an upward
axis. Its rest pose is a rotation C for each part that turns the reference's T-pose into it, so the file's world
rotations are `W C^-1`.
"""

import warnings
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from bunraku.core.body.layout import JOINT_NAMES

SIDES = (("Left", "left"), ("Right", "right"))


@dataclass
class Dialect:
    """`joints`: (name, name of parent, SMPL joint, how far along from its SMPL parent: 1 for the joint itself)."""

    joints: list
    order: str = "ZXY"
    unit: float = 1.0
    rest: str = "T"
    z_up: bool = False
    all_positions: bool = False
    still_root: str = ""
    zero_positions: bool = False
    rate: float = 60.0
    convention: str = ""
    extra: dict = field(default_factory=dict)


def limbs(arm, leg, chest, hips, left, right, between=None):
    """Joints of arms (collar .. wrist) and legs (hip .. foot) named by a pattern with {side}."""
    out = []
    for side, smpl in ((left, "left"), (right, "right")):
        above = hips
        if between:
            out.append((between.format(side=side[0]), hips, f"{smpl}_hip", 0.0))
            above = between.format(side=side[0])
        for name, part in zip(leg, ("hip", "knee", "ankle", "foot"), strict=False):
            out.append((name.format(side=side), above, f"{smpl}_{part}", 1.0))
            above = out[-1][0]
    for side, smpl in ((left, "left"), (right, "right")):
        above = chest
        parts = ("collar", "shoulder", "elbow", "wrist")[-len(arm) :]
        for name, part in zip(arm, parts, strict=True):
            out.append((name.format(side=side), above, f"{smpl}_{part}", 1.0))
            above = out[-1][0]
    return out


def trunk(hips, *names):
    """Spine bones with their SMPL joints, then neck and head."""
    out, above = [], hips
    for name, joint in names:
        out.append((name, above, joint, 1.0))
        above = name
    return out


CMU = Dialect(
    [("Hips", None, "pelvis", 1.0)]
    + trunk("Hips", ("LowerBack", "spine1"), ("Spine", "spine2"), ("Spine1", "spine3"), ("Neck", "neck"))
    + [("Neck1", "Neck", "head", 0.5), ("Head", "Neck1", "head", 1.0)]
    + limbs(["{side}Shoulder", "{side}Arm", "{side}ForeArm", "{side}Hand"], ["{side}UpLeg", "{side}Leg", "{side}Foot",
    "{side}ToeBase"],
            "Spine1", "Hips", "Left", "Right", between="{side}HipJoint")
    + [("LeftFingerBase", "LeftHand", "left_wrist", 1.1), ("LThumb", "LeftHand", "left_wrist", 1.1)],
    order="ZYX", unit=0.0254 / 0.45, rate=120.0, convention="CMU",
)  # fmt: skip
DAZ = Dialect(
    [("hip", None, "pelvis", 1.0)]
    + trunk("hip", ("abdomen", "spine1"), ("chest", "spine3"), ("neck", "neck"), ("head", "head"))
    + [("leftEye", "head", "head", 1.2), ("rightEye", "head", "head", 1.2)]
    + limbs(["{side}Collar", "{side}Shldr", "{side}ForeArm", "{side}Hand"], ["{side}Thigh", "{side}Shin", "{side}Foot"],
    "chest", "hip", "l", "r"),
    order="XZY", unit=0.0254, convention="Daz",
)  # fmt: skip
BANDAI_NAMCO = Dialect(
    [("joint_Root", None, None, 0.0), ("Hips", "joint_Root", "pelvis", 1.0)]
    + trunk("Hips", ("Spine", "spine1"), ("Chest", "spine3"), ("Neck", "neck"), ("Head", "head"))
    + limbs(["Shoulder_{side}", "UpperArm_{side}", "LowerArm_{side}", "Hand_{side}"],
            ["UpperLeg_{side}", "LowerLeg_{side}", "Foot_{side}", "Toes_{side}"], "Chest", "Hips", "L", "R"),
    order="ZXY", unit=0.01, all_positions=True, still_root="joint_Root", rate=30.0, convention="Bandai-Namco",
)  # fmt: skip
MIXAMO = Dialect(
    [("mixamorig:Hips", None, "pelvis", 1.0)]
    + trunk("mixamorig:Hips", ("mixamorig:Spine", "spine1"), ("mixamorig:Spine1", "spine2"), ("mixamorig:Spine2",
    "spine3"),
            ("mixamorig:Neck", "neck"), ("mixamorig:Head", "head"), ("mixamorig:HeadTop_End", "head"))
    + limbs(["mixamorig:{side}Shoulder", "mixamorig:{side}Arm", "mixamorig:{side}ForeArm", "mixamorig:{side}Hand"],
            ["mixamorig:{side}UpLeg", "mixamorig:{side}Leg", "mixamorig:{side}Foot", "mixamorig:{side}ToeBase"],
            "mixamorig:Spine2", "mixamorig:Hips", "Left", "Right"),
    order="XYZ", unit=0.01, convention="Mixamo",
)  # fmt: skip
ROKOKO = Dialect(
    [("Hips", None, "pelvis", 1.0)]
    + trunk("Hips", ("Spine1", "spine1"), ("Spine2", "spine2"))
    + [("Spine3", "Spine2", "spine3", 0.5), ("Spine4", "Spine3", "spine3", 1.0)]
    + trunk("Spine4", ("Neck", "neck"), ("Head", "head"))
    + limbs(["{side}Shoulder", "{side}Arm", "{side}ForeArm", "{side}Hand"], ["{side}Thigh", "{side}Shin", "{side}Foot",
    "{side}Toe"],
            "Spine4", "Hips", "Left", "Right"),
    order="YXZ", unit=0.01, rest="A", zero_positions=True, rate=100.0, convention="Rokoko",
)  # fmt: skip
ALONG_X = Dialect(
    [("Hips", None, "pelvis", 1.0)]
    + trunk("Hips", ("Spine", "spine1"), ("Spine1", "spine2"), ("Spine2", "spine3"), ("Neck", "neck"), ("Head", "head"))
    + limbs(["{side}Shoulder", "{side}Arm", "{side}ForeArm", "{side}Hand"], ["{side}UpLeg", "{side}Leg", "{side}Foot",
    "{side}Toe"],
            "Spine2", "Hips", "Left", "Right"),
    order="ZYX", unit=0.01, rest="X", rate=30.0, convention="MotionBuilder",
)  # fmt: skip
BIPED = Dialect(
    [("Bip01", None, "pelvis", 1.0), ("Bip01 Pelvis", "Bip01", "pelvis", 0.0)]
    + trunk("Bip01 Pelvis", ("Bip01 Spine", "spine1"), ("Bip01 Spine1", "spine3"), ("Bip01 Neck", "neck"),
    ("Bip01 Head", "head"))
    + limbs(["Bip01 {side} Clavicle", "Bip01 {side} UpperArm", "Bip01 {side} Forearm", "Bip01 {side} Hand"],
            ["Bip01 {side} Thigh", "Bip01 {side} Calf", "Bip01 {side} Foot", "Bip01 {side} Toe0"], "Bip01 Spine1",
            "Bip01 Pelvis", "L", "R"),
    order="YZX", unit=0.0254, rest="down", convention="Biped",
)  # fmt: skip
BLENDER = Dialect(
    [("hips", None, "pelvis", 1.0)]
    + trunk("hips", ("spine", "spine1"), ("chest", "spine3"), ("neck", "neck"), ("head", "head"))
    + limbs(["shoulder.{side}", "upper_arm.{side}", "forearm.{side}", "hand.{side}"], ["thigh.{side}", "shin.{side}",
    "foot.{side}", "toe.{side}"],
            "chest", "hips", "L", "R"),
    order="XYZ", z_up=True, rest="back", rate=24.0,
)  # fmt: skip
CLASSIC = Dialect(
    [("Hips", None, "pelvis", 1.0)]
    + trunk("Hips", ("Chest", "spine1"), ("Chest2", "spine3"), ("Neck", "neck"), ("Head", "head"))
    + limbs(["{side}Collar", "{side}Shoulder", "{side}Elbow", "{side}Wrist"], ["{side}Hip", "{side}Knee", "{side}Ankle",
    "{side}Toe"],
            "Chest2", "Hips", "Left", "Right"),
    order="ZXY", unit=0.1, rest="down", convention="Poser",
)  # fmt: skip
NAMELESS = Dialect(
    [("joint_0", None, "pelvis", 1.0)]
    + trunk("joint_0", ("joint_1", "spine1"), ("joint_2", "spine2"), ("joint_3", "spine3"), ("joint_4", "neck"),
    ("joint_5", "head"))
    + limbs(["a{side}", "b{side}", "c{side}", "d{side}"], ["e{side}", "f{side}", "g{side}", "h{side}"], "joint_3",
    "joint_0", "q", "w"),
    order="XYZ", unit=1.0,
)  # fmt: skip
DIALECTS = {
    "cmu": CMU, "daz": DAZ, "bandai-namco": BANDAI_NAMCO, "mixamo": MIXAMO, "rokoko": ROKOKO, "along x": ALONG_X,
    "biped": BIPED,
    "blender": BLENDER, "classic": CLASSIC, "nameless": NAMELESS,
}  # fmt: skip


def rest_rotation(rest, joint):
    """C of a part."""
    side = 1 if "left" in joint else -1
    arm = any(part in joint for part in ("shoulder", "elbow", "wrist"))
    if rest == "A" and arm:
        return Rotation.from_euler("z", -45 * side, degrees=True)
    if rest == "down" and arm:
        return Rotation.from_euler("z", -90 * side, degrees=True)
    if rest == "back":
        return Rotation.from_euler("y", 180, degrees=True)  # faces -Z
    if rest == "X":  # every bone along +X, left and right in opposite rolls
        if arm or "collar" in joint:
            return Rotation.from_euler("xz", [90, 0 if side > 0 else 180], degrees=True)
        if any(part in joint for part in ("hip", "knee", "ankle", "foot")):
            return Rotation.from_euler("xz", [20, 90], degrees=True)
        return Rotation.from_euler("z", -90, degrees=True)
    return Rotation.identity()


def bvh_text(motion, dialect):
    """The file as text."""
    world, positions = motion.world()
    world, positions = world.astype(float), positions.astype(float)
    frames, turned = len(motion), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if dialect.z_up else np.eye(3)
    names = [name for name, *_ in dialect.joints]
    rotations, offsets = {}, {}
    for name, _, joint, share in dialect.joints:
        if joint is None:
            rotations[name], offsets[name] = np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3))
            continue
        index = JOINT_NAMES.index(joint)
        own = (
            index if share >= 1 else max(int(motion.skeleton.parents[index]), 0)
        )  # a bone on the way turns with its parent
        rest = rest_rotation(dialect.rest, JOINT_NAMES[own]).as_matrix()
        rotations[name] = world[:, own] @ rest.T
        parent = max(int(motion.skeleton.parents[index]), 0)
        position = (
            positions[:, parent] + share * (positions[:, index] - positions[:, parent])
            if share <= 1
            else positions[:, index] + 0.05 * world[:, index, :, 0]
        )
        if index == 0:
            position = positions[:, 0]
        offsets[name] = position
    lines, columns = ["HIERARCHY"], []

    def joint(name, depth):
        above = next(parent for own, parent, *_ in dialect.joints if own == name)
        pad = "\t" * depth
        local, way = rotations[name], offsets[name]
        if above is not None:
            local = np.swapaxes(rotations[above], -1, -2) @ local
            way = np.einsum("nji,nj->ni", rotations[above], way - offsets[above])
        way = way @ turned.T / dialect.unit
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            angles = Rotation.from_matrix(turned @ local @ turned.T).as_euler(dialect.order, degrees=True)
        moves = above is None or dialect.all_positions or dialect.zero_positions
        x, y, z = np.zeros(3) if above is None or above == dialect.still_root else way.mean(axis=0)
        lines.extend(
            [
                f"{pad}{'ROOT' if above is None else 'JOINT'} {name}",
                pad + "{",
                f"{pad}\tOFFSET\t{x:.6f}\t{y:.6f}\t{z:.6f}",
            ]
        )
        channels = (["Xposition", "Yposition", "Zposition"] if moves else []) + [
            f"{axis}rotation" for axis in dialect.order
        ]
        lines.append(f"{pad}\tCHANNELS {len(channels)} {' '.join(channels)}")
        if moves:
            columns.append(way if above is None or dialect.all_positions else 0 * way)
        columns.append(angles)
        children = [own for own, parent, *_ in dialect.joints if parent == name]
        for child in children:
            joint(child, depth + 1)
        if not children:
            lines.extend([f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0 0 0", f"{pad}\t}}"])
        lines.append(pad + "}")

    joint(names[0], 0)
    rows = np.concatenate(columns, axis=1)
    lines += ["MOTION", f"Frames: {frames}", f"Frame Time: {1 / dialect.rate:.6f}"]
    return "\n".join(lines) + "\n" + "\n".join(" ".join(f"{value:.6f}" for value in row) for row in rows) + "\n"
