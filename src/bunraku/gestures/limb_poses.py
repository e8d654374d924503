"""Hands and feet where a sentence says, of a person who stands, sits, kneels or lies.

Lengths are those of the reference body, 1.84 m tall; angles were chosen by eye on it.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.body.reference import reference_body
from bunraku.gestures.catalogue import pose_row, read_parts
from bunraku.gestures.play import AT, SIDES
from bunraku.gestures.pose import Foot, Hand, Pose, foot_on, vector
from bunraku.language.limb_phrases import Target
from bunraku.language.posing import Stance

FILE = Path(__file__).with_name("postures.toml")
ARM = 0.625
"""From the shoulder to the palm of a straight arm, measured on the reference body [m]."""


@functools.cache
def postures_file() -> dict[str, Any]:
    """The tables of `postures.toml`."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


@functools.cache
def postures(section: str) -> dict[str, Pose]:
    """The poses of a section of `postures.toml`; a hand is the right one of a pose."""
    rows: dict[str, dict[str, Any]] = postures_file()[section]
    return {name: pose_row({"right": row} if section == "hands" else row) for name, row in rows.items()}


def _height(level: str) -> float:
    """How high "hip", "chest", "shoulder" and "head" of the standing body are [m]."""
    joint = "spine3" if level == "chest" else level if level in AT else f"left_{level}"
    return float(reference_body().joints[AT[joint], 1])


def low_place(target: Target, side: str, positions: np.ndarray) -> np.ndarray | None:
    """Where a hand is on the legs or on the floor, in the world [m], shape (3,); None for other places."""
    sign = dict(SIDES)[side]
    hand_side = target.at_side or side
    if target.at == "floor":
        pelvis = positions[AT["pelvis"]]
        ahead = -0.3 if "back" in target.ways or target.by == "behind" else 0.3
        return np.array([pelvis[0] + sign * 0.22, 0.03, pelvis[2] + ahead])
    if not (joint := target.low):
        return None
    knees = {name: positions[AT[f"{name}_knee"], 1] for name in ("left", "right")}
    if target.at == "knee" and not target.at_side and abs(knees["left"] - knees["right"]) > 0.2:
        hand_side = max(knees, key=knees.__getitem__)  # the knee that is up
    place = positions[AT[f"{hand_side}_{joint}"]]
    hip = positions[AT[f"{hand_side}_hip"]]
    if target.at == "buttocks":
        return place + np.array([0, -0.05, -0.12])
    along = place - hip
    out = np.array([0, 0, 1.0]) - along * along[2] / max(float(along @ along), 1e-6)
    out = out if np.linalg.norm(out) > 0.3 else np.array([0, 1.0, 0])
    return place + 0.075 * out / np.linalg.norm(out) + np.array([0, 0.02, 0])


def hand_of(
    target: Target, side: str, sign: float, stance: Stance, rotations: np.ndarray, positions: np.ndarray
) -> Hand:
    """How a hand is held."""
    hands, parts, ways = postures("hands"), read_parts(), target.ways
    low = low_place(target, side, positions)
    if low is not None:
        down = (-0.2, -0.5, 0.8)
        if target.at == "floor":
            down = (0.3, -0.3, -1.0) if "back" in ways else (0.1, -0.3, 1.0)
        return Hand(vector(low * [sign, 1, 1]), down, elbow=(0.8, 0.1, -0.7), on="ground")
    behind = target.by == "behind" and target.at in ("back", "trunk", "hip", "buttocks", "belly")
    if behind or ways >= {"crossed", "back"}:
        return hands["behind"].right
    if target.by == "behind" and target.at in ("head", "back-head", "neck"):
        return parts["back-head"][1].right
    if target.by == "above" and target.at == "head":
        ways = ways | {"up"}
    elif target.at == "hip" and target.by == "on":
        return hands["hip"].right
    elif target.at in parts and target.by in ("on", "front", "under", "above"):
        return _at_part(target, side, parts[target.at][1].right)
    if "crossed" in ways:
        return hands["crossed" if side == "right" else "under"].right
    if target.limb == "elbow" and "bent" not in ways:
        return hands["elbows-front" if ways & {"together", "ahead"} else "elbows"].right
    if ways <= {"bent"}:
        return hands["bent"].right
    if "together" in ways and not ways & {"up", "down"}:
        return hands["together"].right
    return _stretched(target._replace(ways=ways), side, sign, stance, rotations, positions)


def _at_part(target: Target, side: str, hand: Hand) -> Hand:
    """A hand at a part of the body, or in front of it."""
    x, y, z = hand.palm
    if target.at == "shoulder" and target.at_side == side:
        x, hand = 0.2, replace(hand, elbow=(0.8, -0.6, 0.9))
    if target.side == "both":
        x = max(x, 0.03 if "together" in target.ways else 0.07)
        if target.at == "shoulder":
            x = -0.13
    if target.by == "front":
        return replace(hand, palm=(max(x, 0.06), y, z + 0.15), fingers=(-0.5, 0.6, 0.5), faces=(-0.6, 0.1, -0.6))
    return replace(hand, palm=(x, y, z))


def _stretched(
    target: Target, side: str, sign: float, stance: Stance, rotations: np.ndarray, positions: np.ndarray
) -> Hand:
    """A hand of an arm that goes into a direction, straight or bent."""
    ways, far = target.ways, target.amount
    chest, shoulder = rotations[AT["spine3"]], positions[AT[f"{side}_shoulder"]]
    aside = 1.0 if "side" in ways or side in ways else 0.0
    across = 1.0 if {"left", "right"} & ways and side not in ways else 0.0
    aside -= 0.9 * across
    along = float("ahead" in ways) - float("back" in ways)
    if target.by == "level" and not aside and not along:
        along = 1.0
    across_chest = chest[:, 0]  # an arm out to the side goes with the chest
    onward = np.cross(across_chest * [1, 0, 1], [0, 1.0, 0])
    level = sign * aside * across_chest + along * onward / max(float(np.linalg.norm(onward)), 1e-6)
    up = float("up" in ways) - float("down" in ways)
    if target.by == "level":
        rises = float(np.degrees(np.arcsin(np.clip((_height(target.at) - _height("shoulder")) / ARM, -1, 1))))
    elif level.any():
        rises = 50.0 * up if up else 0.0
        if "back" in ways and not up:
            rises = -32.0
        if target.amount < 1:
            rises = -90 + (90 + rises) * target.amount
        elif target.amount > 1 and up >= 0 and ways & {"up"}:
            rises = 65.0
    else:
        rises = (90.0 if far >= 1 else -90 + 180 * 0.75 * far) if up > 0 else -86.0
        level = np.array([sign * 0.2, 0, 0.25 if far >= 1 or up < 0 else 1.0])
    level = level / max(float(np.linalg.norm(level)), 1e-6)
    rise = np.radians(rises)
    way = np.cos(rise) * level + np.sin(rise) * np.array([0, 1.0, 0])
    if abs(rises) > 85:
        way = np.array([sign * 0.08, np.sign(rises), 0.06])
        way /= np.linalg.norm(way)
    if stance.name == "back":  # ahead of the chest is up
        way = chest @ way
    elif stance.name == "belly":  # and overhead ahead
        overhead = bool(ways & {"ahead", "up"}) and "side" not in ways
        way = chest @ (np.array([sign * 0.12, 1.0, 0.05]) if overhead else np.array([way[0], min(way[1], 0.0), 0.05]))
    reach = ARM * (0.72 if "bent" in ways else 1.2)  # farther than it reaches, so that it stays straight
    goal = shoulder + reach * way
    if "together" in ways:
        goal[0] = positions[AT["spine3"], 0] + sign * 0.02
    goal[1] = max(goal[1], 0.05)
    rest = reference_body().joints.astype(float)[AT["spine3"]]
    palm = chest.T @ (goal - positions[AT["spine3"]]) + rest
    inside = np.array([-sign, 0, 0])
    faces = inside if abs(way[1]) > 0.75 else np.array([0, -1.0, 0])
    if up > 0 and abs(rises) > 60:
        faces = np.array([-0.4 * sign, 0, 0.9])
    elbow = np.array([0.5 * sign, -0.7, -0.5]) if rises < 45 else np.array([sign, 0, 0.1])
    if rises < -60:
        elbow = np.array([0.35 * sign, 0, -1.0])
    out = np.array([sign, 1, 1])
    ways_of_hand = [vector((chest.T @ direction) * out) for direction in (way, faces, elbow)]
    return Hand(vector(palm * out), ways_of_hand[0], ways_of_hand[1], ways_of_hand[2])


LEG, THIGH, SHANK = 0.89, 0.448, 0.454
"""From hip to ankle of a nearly straight leg, hip to knee, knee to ankle, measured on the reference body [m]."""
OVER, LIFTED = 0.1, 0.09
"""How far the pelvis goes over the foot that stands, and the height of an ankle over which it is in the air [m]. Chosen
by eye on sheets of gestures.
"""
AHEAD, BACK, SIDE, KNEE = 46.0, 37.0, 40.0, 80.0
"""How far a leg, or a thigh, goes from hanging as usual [degrees]."""
MOST, MOST_FOLDED = 108.0, 116.0
"""The same of a straight leg, and of a thigh with a bent knee, at the most."""


def with_legs(pose: Pose, stance: Stance, targets: Sequence[Target]) -> Pose:
    """A pose with legs where some targets say.

    Args:
        pose: Of the stance alone.
        stance: Of the body.
        targets: Of legs and of the pelvis.
    """
    for target in targets:
        if target.limb == "hips":
            pose = _shifted(pose, target)
        elif target.side == "both":
            pose = _both(pose, stance, target)
        else:
            pose = _single(pose, stance, target, "right" if target.side == "one" else target.side)
    return _grounded(pose) if stance.name in ("stand", "squat") and targets else pose


def _shifted(pose: Pose, target: Target) -> Pose:
    """The pelvis to a side, ahead or back."""
    ways, far = target.ways, target.amount
    way = float("left" in ways or target.at_side == "left") - float("right" in ways or target.at_side == "right")
    along = float("ahead" in ways) - float("back" in ways)
    x, y, z = pose.hips
    ahead, turn, aside = pose.lean
    hips = (x + 0.16 * way * far, y - 0.01 * abs(way), z + 0.18 * along * far)
    return replace(pose, hips=hips, lean=(ahead - 18 * along * far, turn, aside + 5 * way * far))


def _both(pose: Pose, stance: Stance, target: Target) -> Pose:
    ways, far = target.ways, target.amount
    lies = stance.name in ("back", "belly", "floor")
    if "crossed" in ways or lies or stance.name == "chair":
        right, left = Foot((-0.09, 0.081, 0.12), turn=-4), Foot((-0.03, 0.081, -0.02), turn=2)
        if "crossed" not in ways:
            right, left = (_free(pose, stance, target, side) for side in ("right", "left"))
        elif lies:
            right, left = (replace(foot, ankle=(0.01, *foot.ankle[1:])) for foot in (pose.right_foot, pose.left_foot))
        elif stance.name == "chair":
            right, left = Foot((-0.2, 0.4, 0.36), 15, (-0.2, 0.8, 1)), Foot((0.08, 0.081, 0.02))
        return replace(pose, right_foot=right, left_foot=left)
    x, y, z = pose.hips
    if "tiptoe" in ways:
        foot = foot_on(0.1, 0.0, 34 * min(far, 1.3))
        return replace(pose, hips=(x, y + 0.075, z + 0.05), right_foot=foot, left_foot=foot)
    if ways & {"apart", "side", "together"}:
        foot = Foot((0.055 if "together" in ways else 0.12 + 0.22 * far, 0.081, 0))
        pose = replace(pose, right_foot=foot, left_foot=foot)
    if "bent" in ways:
        ahead, turn, aside = pose.lean
        pose = replace(pose, hips=(x, y - 0.2 * far, z - 0.05 * far), lean=(ahead + 12 * far, turn, aside))
    return pose


def _single(pose: Pose, stance: Stance, target: Target, side: str) -> Pose:
    """A leg that goes somewhere; where it is lifted, the pelvis of a standing body goes over the other one."""
    sign = dict(SIDES)[side]
    foot = _free(pose, stance, target, side)
    if foot.ankle[1] > LIFTED and stance.name in ("stand", "squat"):
        x, y, z = pose.hips
        ahead, turn, aside = pose.lean
        out, _, along = np.array(foot.ankle) - Foot().ankle
        lean = (ahead - (6 * along if along > 0 else 36 * along), turn, aside - sign * 14 * out)
        pose = replace(pose, hips=(x - sign * OVER, y - 0.012, z), lean=lean)
        foot = _free(pose, stance, target, side)
    return replace(pose, right_foot=foot) if side == "right" else replace(pose, left_foot=foot)


def _free(pose: Pose, stance: Stance, target: Target, side: str) -> Foot:
    """A foot in the air, or on the ground where it stands elsewhere."""
    sign, foot = dict(SIDES)[side], getattr(pose, f"{side}_foot")
    hip = reference_body().joints.astype(float)[AT[f"{side}_hip"]] + pose.hips
    if stance.name in ("back", "belly", "floor"):
        return _lying(foot, hip, sign, stance, target)
    if stance.name == "chair":
        return _seated(foot, hip, sign, target)
    kneels = stance.name in ("kneel", "both knees", "crossed")
    return foot if kneels else _standing(foot, hip, sign, target, side)


def _seated(own: Foot, hip: np.ndarray, sign: float, target: Target) -> Foot:
    ways, far = target.ways, target.amount
    if "apart" in ways:
        return replace(own, ankle=(0.12 + 0.16 * far, *own.ankle[1:]), knee=(0.6, 0, 1))
    if "back" in ways:
        return _aimed(hip, sign, np.array([0, -0.05, 1.0]), own, folded=118)
    if target.limb == "leg" and ways & {"ahead", "up", "straight", "side"}:
        out = 0.3 * sign if "side" in ways else 0.0
        return _aimed(hip, sign, np.array([out, -0.16 + 0.15 * (far - 1), 1.0]), own)
    return _aimed(hip, sign, np.array([0, 0.45 * far, 1.0]), own, folded=95) if ways & {"up"} or target.at else own


def _standing(own: Foot, hip: np.ndarray, sign: float, target: Target, side: str) -> Foot:
    ways, far = target.ways, target.amount
    level = target.at if target.by == "level" else {"chest": "chest", "belly": "chest"}.get(target.at, "")
    if target.at in ("buttocks", "back"):
        return _aimed(hip, sign, np.array([0, -1.0, 0.08]), own, folded=128)
    if target.at == "knee" and target.limb in ("leg", "heel"):
        return Foot((-0.08, 0.53, 0.03), 50, (1, 0, 0.5), 40)
    if "lifted" in ways:
        return Foot((0.12, 0.42, 0.06), 28, (0.15, 0, 1))
    if "apart" in ways:
        return Foot((0.12 + 0.3 * far, 0.081, 0))
    if "tiptoe" in ways:
        return foot_on(0.12, 0.0, 34)
    if "bent" in ways and not level:
        return _aimed(hip, sign, np.array([0, -1.0, 0.15]), own, folded=80 * min(far, 1.5))
    if "back" in ways:
        return _aimed(hip, sign, _ahead(-min(BACK * far, 50)), own)
    aside = 1.0 if "side" in ways or side in ways else -1.0 if ways & {"left", "right"} else 0.0
    if aside and "ahead" not in ways:
        turn = np.radians(min((SIDE if aside > 0 else 0.8 * SIDE) * far, 75)) * aside
        return _aimed(hip, sign, np.array([sign * np.sin(turn), -np.cos(turn), 0.0 if aside > 0 else 0.25]), own)
    if target.limb == "leg" and (level or ways & {"ahead", "straight"}):
        return _aimed(hip, sign, _ahead(min(_swung(level, LEG) if level else AHEAD * far, MOST)), own)
    angle = min(_swung(level, THIGH) if level else KNEE * min(far, 1.35), MOST_FOLDED)
    return _aimed(hip, sign, _ahead(angle), own, folded=angle + 4)


def _swung(level: str, length: float) -> float:
    """How far a leg of this length is ahead of hanging down whose end is at a level of the body [degrees]."""
    return float(np.degrees(np.arccos(np.clip((_height("hip") - _height(level)) / length, -1, 1))))


def _ahead(degrees: float) -> np.ndarray:
    """The direction of a leg so far ahead of hanging down."""
    turn = np.radians(degrees)
    return np.array([0, -np.cos(turn), np.sin(turn)])


def _aimed(hip: np.ndarray, sign: float, way: np.ndarray, own: Foot, folded: float = 0.0) -> Foot:
    """A foot of a leg whose thigh points into a direction, straight or with the knee folded so far [degrees]."""
    way = way / np.linalg.norm(way)
    turn = np.radians(folded)
    cosine, sine = np.cos(turn), np.sin(turn)
    shank = np.array([way[0], way[1] * cosine - way[2] * sine, way[1] * sine + way[2] * cosine])
    ankle = hip + THIGH * way + (SHANK if folded else LEG - THIGH) * shank
    front = np.array([0.1 * sign, way[2], -way[1]])  # to where a knee is bent
    if folded:
        front = hip + THIGH * way - 0.5 * (hip + ankle)
    pitch = np.degrees(np.arctan2(-shank[2], -shank[1]))
    pitch = 0.5 * pitch if pitch < 0 and not folded else pitch + 12
    return Foot(vector(ankle * [sign, 1, 1]), float(np.clip(pitch, -75, 120)), vector(front * [sign, 1, 1]), own.turn)


def _lying(own: Foot, hip: np.ndarray, sign: float, stance: Stance, target: Target) -> Foot:
    """A foot of a body that lies, or sits on the floor with straight legs."""
    ways, far = target.ways, target.amount
    x, y, z = own.ankle
    if "apart" in ways or ("side" in ways and "up" not in ways):
        return replace(own, ankle=(0.13 + 0.3 * min(far, 1.4), y, z - np.sign(z) * 0.06))
    if stance.name == "belly":
        turn = np.radians(22 * min(far, 1.4))
        if "bent" in ways or target.limb in ("knee", "heel"):
            return replace(own, ankle=(x, 0.46, float(hip[2] - THIGH)), pitch=60.0)
        ankle = hip + LEG * np.array([0.02 * sign, np.sin(turn), -np.cos(turn)])
        return replace(own, ankle=vector(ankle * [sign, 1, 1]))
    if "bent" in ways and not ways & {"up"}:
        return Foot((0.13, 0.081, float(hip[2] + 0.5)), 0.0, (0.15, 1.0, 0.3), 8)
    if target.limb == "knee" or target.at in ("chest", "belly"):
        return _aimed(hip, sign, np.array([0, 1.0, -0.1 if target.at else 0.25]), own, folded=95)
    if not ways & {"up", "ahead", "straight"} and target.by != "level":
        return own
    turn = np.radians(min((62 if stance.name == "back" else 24) * far, 88))
    ankle = hip + LEG * np.array([0.02 * sign, np.sin(turn), np.cos(turn)])
    return Foot(vector(ankle * [sign, 1, 1]), -70.0, (0.1, 1.0, -0.4), 6)


def _grounded(pose: Pose) -> Pose:
    """A pose whose pelvis is so low that feet on the ground are reached."""
    rest = reference_body().joints.astype(float)
    low = 0.0
    for side, sign in SIDES:
        foot: Foot = getattr(pose, f"{side}_foot")
        if foot.ankle[1] < 0.2:
            hip = rest[AT[f"{side}_hip"]] + pose.hips
            away = np.array(foot.ankle) * [sign, 1, 1] - hip
            across = min(float(np.hypot(away[0], away[2])), LEG - 0.05)
            low = max(low, hip[1] - foot.ankle[1] - float(np.sqrt((LEG + 0.006) ** 2 - across**2)))
    x, y, z = pose.hips
    return replace(pose, hips=(x, y - low, z)) if low > 0 else pose
